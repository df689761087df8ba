"""From a start in a store to a method with a certificate in a file of its own."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ...catalogue import methods, munthe_kaas, save
from ...catalogue.entries import CERTIFICATE_SUFFIX
from ...method.method import Method
from ...proofs import Certificate, CertificationError, certify
from ...runs import StoredRun
from ...support.checks import check_integer
from ...support.parallel import single_threads
from ...support.parsing import file_in
from ..candidate import to_method
from ..optimise import Goals, optimise
from .solutions import Solution, solutions

__all__ = ["Promotion", "promote"]


@dataclass(frozen=True)
class Promotion:
    """What became of a start.

    Attributes
    ----------
    method : Method
        Exact in binary128.
    principal_error : float
        After optimisation.
    before : float
        The principal error of the start itself.
    certificate : Certificate or None
        None if there is no proof. It isn't `complete` where some conditions are only shown to be
        small.
    reason : str
        Why there is no complete one.
    files : tuple of Path
        The method's, and the certificate's if there is one.
    """

    method: Method
    principal_error: float
    before: float
    certificate: Certificate | None
    reason: str
    files: tuple[Path, ...]


@single_threads()
def promote(
    run: StoredRun,
    name: str,
    folder: str | os.PathLike[str],
    *,
    number: int | None = None,
    goals: Goals | None = None,
    max_iterations: int = 60,
) -> Promotion:
    """Make a method of a start: optimise along the solution set, refine, certify, write.

    Parameters
    ----------
    run : StoredRun
    name : str
        Of the method; fit for a file's name.
    folder : path
        Where ``NAME.toml`` goes, and ``NAME.certificate.toml``; from a folder in which `cg.methods`
        looks the method is known by its name, with its certificate. In a folder like that of the
        package's catalogue, with a folder ``certificates``, the certificate goes there, and
        ``make catalogue`` and ``make docs`` do the rest.
    number : int, optional
        Which start; by default the one of the smallest principal error.
    goals : Goals, optional
        What to minimise on the way; by default the principal error.
    max_iterations : int, optional
        Steps along the solution set; none with 0.

    Raises
    ------
    ValueError
        If the run has no such solution, the name isn't fit for a file's name, the package has a
        method of that name, or a file of that name is there already.
    NotADirectoryError
        If there is no such folder.

    Examples
    --------
    >>> import tempfile, cg
    >>> from cg.runs import Store
    >>> folder = tempfile.mkdtemp()
    >>> _ = cg.search(order=3, stages=3, starts=6, seed=5, store=folder + "/runs.db")
    >>> with Store(folder + "/runs.db") as store:
    ...     promoted = promote(store.run(1), "Mine", folder)
    >>> promoted.method.order, promoted.certificate is not None
    (3, True)
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise NotADirectoryError(f"folder must be one that exists, got {str(folder)!r}")
    if name in methods or name in munthe_kaas:
        raise ValueError(f"name must be a new one, got {name!r}, which the package has")
    proofs = folder / "certificates"
    file = file_in(folder, name)
    proof = file_in(proofs, name) if proofs.is_dir() else file_in(folder, name, CERTIFICATE_SUFFIX)
    for path in (file, proof):
        if path.exists():
            raise ValueError(f"name must be a new one, got {name!r}: {path} is there already")
    chosen = _chosen(run, number)
    better = chosen.candidate
    if check_integer("max_iterations", max_iterations, 0):
        better = optimise(better, goals or Goals(), max_iterations=max_iterations)
    settings = run.settings()
    source = (
        f"{run.kind()}, seed {settings['seed']}, start {chosen.record.number}"
        f"{', then along the solution set' if max_iterations else ''}"
    )
    method = to_method(better, name=name, source=source)
    certificate, reason = _proved(method)
    save(method, file)
    files = [file]
    if certificate is not None:
        certificate.save(proof)
        files.append(proof)
    after = Solution(chosen.record, better).principal_error
    return Promotion(method, after, chosen.principal_error, certificate, reason, tuple(files))


def _proved(method: Method) -> tuple[Certificate | None, str]:
    """Return a certificate, or else one in part, or else none; and why it isn't a whole one."""
    try:
        return certify(method), ""
    except CertificationError as error:
        reason = str(error)
    try:
        return certify(method, small=True), reason
    except CertificationError:
        return None, reason


def _chosen(run: StoredRun, number: int | None) -> Solution:
    found = list(solutions(run))
    if not found:
        raise ValueError(f"run {run.number} has no start that led to what was wanted")
    if number is None:
        return min(found, key=lambda one: one.principal_error)
    for one in found:
        if one.record.number == number:
            return one
    raise ValueError(
        f"number must be that of a solution, {[one.record.number for one in found][:20]} …, "
        f"got {number!r}"
    )
