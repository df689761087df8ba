"""Write a solution of a long run as a method with its certificate."""

import os
from dataclasses import dataclass
from pathlib import Path

from cg.construction.candidate import to_method
from cg.construction.catalogue import methods, save
from cg.construction.catalogue.entries import CERTIFICATE_SUFFIX
from cg.construction.methods.method import Method
from cg.construction.optimise import Goals, optimise
from cg.construction.proofs import Certificate, CertificationError, certify
from cg.construction.results.solutions import StoredSolution, solutions
from cg.construction.runs import StoredRun
from cg.support.checks import check_integer
from cg.support.parallel import single_threads
from cg.support.parsing import file_in


@dataclass(frozen=True)
class Publication:
    """A method made of a solution, with its files and its principal errors."""

    method: Method
    principal_error: float
    initial_principal_error: float  # before optimisation
    certificate: Certificate | None
    reason: str  # why there is no complete certificate
    files: tuple[Path, ...]


@single_threads()
def publish(
    run: StoredRun,
    name: str,
    folder: str | os.PathLike[str],
    *,
    number: int | None = None,
    goals: Goals | None = None,
    max_iterations: int = 60,
) -> Publication:
    """Optimise a solution of a run, refine and certify it, and write NAME.toml and its certificate.

    The solution is that of the start `number`, by default the one with the smallest principal
    error. If `folder` has a folder ``certificates``, as the catalogue has, the certificate goes
    there. ValueError if there is no such solution, or the name exists.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise NotADirectoryError(f"folder must be an existing folder, got {str(folder)!r}")
    if name in methods:
        raise ValueError(f"name must be new, got {name!r}, a method of the package")
    proofs = folder / "certificates"
    file = file_in(folder, name)
    proof = file_in(proofs, name) if proofs.is_dir() else file_in(folder, name, CERTIFICATE_SUFFIX)
    for path in (file, proof):
        if path.exists():
            raise ValueError(f"name must be new, got {name!r}: {path} exists")
    chosen = _choose(run, number)
    candidate = chosen.candidate
    if check_integer("max_iterations", max_iterations, 0):
        candidate = optimise(candidate, goals or Goals(), max_iterations=max_iterations)
    settings = run.settings()
    source = (
        f"{run.kind()}, seed {settings['seed']}, start {chosen.start.number}"
        f"{', then along the solution set' if max_iterations else ''}"
    )
    method = to_method(candidate, name=name, source=source)
    certificate, reason = None, ""
    try:
        certificate = certify(method)
        reason = "" if certificate.complete else certificate.statement
    except CertificationError as error:
        reason = str(error)
    save(method, file)
    files = [file]
    if certificate is not None:
        certificate.save(proof)
        files.append(proof)
    return Publication(
        method=method,
        principal_error=candidate.principal_error,
        initial_principal_error=chosen.principal_error,
        certificate=certificate,
        reason=reason,
        files=tuple(files),
    )


def _choose(run: StoredRun, number: int | None) -> StoredSolution:
    distinct = {solution.start.number: solution for solution in solutions(run)}
    if not distinct:
        raise ValueError(f"run {run.number} has no start that led to a method")
    if number is None:
        return min(distinct.values(), key=lambda solution: solution.principal_error)
    if number not in distinct:
        raise ValueError(
            f"number must be that of a solution, {list(distinct)[:20]} …, got {number!r}"
        )
    return distinct[number]
