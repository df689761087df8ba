"""The certificates of the catalogue: one TOML file for each method that has one."""

from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from cg.construction.catalogue import find_method
from cg.construction.catalogue.entries import certificate_path
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas
from cg.construction.proofs.certificate import Certificate, CertificationError
from cg.construction.proofs.packed import fitting
from cg.support.checks import check_instance


def folder() -> Traversable:
    """Return the folder of the certificates."""
    return files("cg.construction.catalogue") / "certificates"


def certificate_names() -> list[str]:
    """Return the names of the methods that have certificates."""
    names = [path.name for path in folder().iterdir()]
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def certificate_of(method: Method) -> Certificate:
    """Return the certificate in the catalogue or beside the method's file, unchecked."""
    check_instance("method", method, Method)
    name = method.name
    if find_method(name) != method:
        if (beside := certificate_beside(method)) is not None:
            return beside
        raise CertificationError(
            f"{name or 'the method'} isn't in the catalogue"
            f"{', and no certificate lies beside its file' * (method.file is not None)}: "
            "pass certificate=cg.certify(method)"
        )
    path = folder() / f"{name}.toml"
    if not path.is_file():
        raise CertificationError(f"{name} has no certificate")
    if isinstance(path, Path):
        return Certificate.load(path)
    # the package isn't a folder
    return Certificate.loads(path.read_text(encoding="utf-8"))


def proved(method: Method) -> str:
    """Return how much of a method's order its certificate proves.

    ``"yes"``, ``"in part"`` or ``"no"``; ``"classical"`` for Munthe-Kaas methods.
    """
    if isinstance(method, MuntheKaas):
        return "classical"
    try:
        return certificate_of(method).proved
    except CertificationError:
        return "no"


def certificate_beside(method: Method) -> Certificate | None:
    """Return the certificate beside the file of a method, or None; `check` proves it."""
    path = None if method.file is None else certificate_path(method.file)
    if path is None or not path.is_file():
        return None
    certificate = Certificate.load(path)
    fitting(certificate, method)
    return certificate
