"""Export of a method to a data file, a LaTeX table, one step in Python or C, other packages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cg.construction.catalogue import dumps, dumps_json, resolve_method
from cg.construction.formats.c import to_c, with_free_motion
from cg.construction.formats.code import make_program, to_python
from cg.construction.formats.digits import numbers_of
from cg.construction.formats.latex import to_latex
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.frames.base import Frame, check_frame
from cg.frames.phase_space import PhaseSpace
from cg.support.checks import check_choice

if TYPE_CHECKING:
    from cg.construction.proofs import Certificate

FORMATS = {"json": ".json", "toml": ".toml", "latex": ".tex", "python": ".py", "c": ".h"}
"""Suffix of the files of each format."""


def export(
    method: str | Method, format: str, *, digits: int | None = None,
    certificate: Certificate | None = None, frame: Frame | None = None,
) -> str:  # fmt: skip
    """Return a method as the text of a file: data, a LaTeX table, or code for one step.

    ``"json"`` and ``"toml"`` are data files, which `catalogue.loads` reads. ``"latex"`` is a
    table for the package booktabs: a tableau, a list of its entries if they are too long for one,
    or the points of a commutator-free method. ``"python"`` (for NumPy) and ``"c"`` are source files
    with a function for one step, without dependencies; the right-hand side and the flow of the
    frame are arguments of the step. With ``frame`` the C file has its flow.

    Parameters
    ----------
    method
        A method, the name of one in the catalogue, or the path of its file.
    format
        One of `FORMATS`.
    digits
        Significant digits, at most 4000, of coefficients that aren't rational, and in code of all
        coefficients. By default, data files have the stored digits, and code has enough digits to
        give the same doubles as this package. Digits beyond the stored ones are computed from
        the certificate.
    certificate
        Certificate of the method (`cg.certify`); by default the one in the catalogue.
    frame
        With ``"c"`` only: a frame of unit quaternions, rotations of space, points of the sphere in
        space and vectors, or a product or power of them, whose flow the file has. Of a splitting
        method their `cg.frames.PhaseSpace`, without spheres, whose free motion the file has.

    Returns
    -------
    str
        Text of a file with the suffix ``FORMATS[format]``.

    Raises
    ------
    CertificationError
        If the certificate isn't one for the method.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.construction.catalogue.loads(export("CG2", "toml")) == cg.methods["CG2"]
    True
    >>> "static inline int cg2_step(" in export("CG2", "c")
    True
    """
    method = resolve_method(method)
    check_choice("format", format, FORMATS)
    mechanical = format == "c" and isinstance(method, Splitting)
    only_data = isinstance(method, MagnusMethod | Splitting) and not mechanical
    if only_data and format not in ("json", "toml"):
        raise ValueError(f"format must be json or toml for the method {method!r}, got {format!r}")
    if frame is not None:
        check_frame(frame)
        if format != "c":
            raise ValueError(f"frame must be None unless format is 'c', got {frame!r}")
    if mechanical != isinstance(frame, PhaseSpace):
        kind = "be" if mechanical else "not be"
        raise ValueError(f"frame must {kind} a PhaseSpace for the method {method!r}, got {frame!r}")
    numbers = numbers_of(method, digits, certificate)
    if format == "json":
        return dumps_json(numbers.rounded())
    if format == "toml":
        return dumps(numbers.rounded())
    if format == "latex":
        return to_latex(numbers)
    if isinstance(frame, PhaseSpace):
        return with_free_motion(numbers, frame)
    program = make_program(numbers)
    return to_python(program) if format == "python" else to_c(program, frame)
