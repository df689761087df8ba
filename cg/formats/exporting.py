"""Methods written for elsewhere: data, documents, and steps in other languages."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from ..catalogue import dumps, dumps_json, resolve_method
from ..method.method import Method
from ..support.parsing import visible
from .c import to_c
from .digits import numbers_of
from .fortran import to_fortran
from .julia import to_julia
from .latex import to_latex
from .matlab import to_matlab
from .program import Program, make_program
from .python import to_jax, to_python

if TYPE_CHECKING:
    from ..proofs import Certificate

__all__ = ["FORMATS", "export", "summary"]

_CODE: dict[str, Callable[[Program], str]] = {
    "python": to_python,
    "c": to_c,
    "fortran": to_fortran,
    "julia": to_julia,
    "matlab": to_matlab,
    "jax": to_jax,
}

FORMATS = {
    "json": ".json",
    "toml": ".toml",
    "latex": ".tex",
    "python": ".py",
    "c": ".h",
    "fortran": ".f90",
    "julia": ".jl",
    "matlab": ".m",
    "jax": ".py",
}
"""The formats, with the suffix of their files."""


def export(
    method: str | Method,
    format: str,
    *,
    digits: int | None = None,
    certificate: Certificate | None = None,
) -> str:
    """Write a method for another program, language or document.

    ``"json"`` and ``"toml"`` are data, which `cg.catalogue.loads` reads back. ``"latex"`` is a
    table for the package booktabs: a tableau, a list of entries where these have too many digits
    for that, or the points of a commutator-free method. The others are a module, a header or a
    function file with a step: ``"python"`` (for NumPy), ``"jax"`` (pure functions), ``"c"``,
    ``"fortran"``, ``"julia"`` and ``"matlab"`` (for Octave too). They have no other needs; the
    right-hand side and the flows of the frame are arguments.

    Parameters
    ----------
    method : str or Method
        A method, or the name of one in the catalogue.
    format : str
        One of `FORMATS`.
    digits : int, optional
        Significant digits of all coefficients that aren't known exactly, at most 4000; in code of
        all coefficients. By default data have those that are stored, and code so many that
        the doubles are those of this package. More than are stored come from the certificate.
    certificate : cg.Certificate, optional
        By default the one of the catalogue, if there is one; see `cg.certify`.

    Returns
    -------
    str
        The text of a file with the suffix ``FORMATS[format]``.

    Raises
    ------
    TypeError
        If an argument isn't of the type listed.
    ValueError
        If there is no such method or format, `digits` is out of range or more than are known, or
        the method is implicit and the format has a step.
    CertificationError
        If the certificate isn't one of the method.

    Examples
    --------
    >>> import cg
    >>> cg.catalogue.loads(export("CG2", "toml")) == cg.methods["CG2"]
    True
    >>> "static inline int cg2_step(" in export("CG2", "c")
    True
    """
    method = resolve_method(method)
    if not isinstance(format, str):
        raise TypeError(f"format must be a str, got {format!r}")
    if format not in FORMATS:
        raise ValueError(f"format must be one of {', '.join(FORMATS)}, got {format!r}")
    numbers = numbers_of(method, digits, certificate)
    if format == "json":
        return dumps_json(numbers.rounded())
    if format == "toml":
        return dumps(numbers.rounded())
    if format == "latex":
        return to_latex(numbers, summary(method))
    return _CODE[format](make_program(numbers, summary(method)))


def summary(method: Method) -> str:
    """Return what a method is, in one line.

    Examples
    --------
    >>> import cg
    >>> summary(cg.methods["CG4(3)b"])
    'CG4(3)b: order 4(3), 5 evaluations, 15 flows'
    """
    return f"{visible(method.name) or 'without name'}: {method.description(complete=True)}"
