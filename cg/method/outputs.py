"""Files, exports, digits and views of methods: calls of folders that come after this one."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any, Self, cast

if TYPE_CHECKING:
    from ..proofs import Certificate
    from .method import Method


class Outputs:
    """Base class of `cg.Method`; the only one that imports later folders, when it is called."""

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a method of this class from a file, in TOML or JSON.

        A certificate beside the file proves digits beyond the stored ones; see `digits`.

        Parameters
        ----------
        path : path

        Returns
        -------
        Method
            A `cg.Tableau` from ``cg.Tableau.load``, and so on; any kind from ``cg.Method.load``.

        Raises
        ------
        TypeError
            If `path` isn't one.
        MethodError
            If the file holds no method, or one of another kind.
        OSError
            If the file can't be read.
        """
        from ..catalogue.entries import load_kind

        return cast(Self, load_kind(cast(Any, cls), path))

    def save(self, path: str | PathLike[str]) -> None:
        """Write the method to a file; see `cg.catalogue.save`."""
        from ..catalogue.entries import save

        save(cast("Method", self), path)

    def export(
        self, format: str, *, digits: int | None = None, certificate: Certificate | None = None
    ) -> str:
        """Write the method for another program, language or document; see `cg.export`."""
        from ..formats.exporting import export

        return export(cast("Method", self), format, digits=digits, certificate=certificate)

    def digits(
        self, digits: int, *, certificate: Certificate | None = None, embedded: bool = False
    ) -> Any:
        """Return proved coefficients to any number of digits; see `cg.proofs.digits.digits`."""
        from ..proofs.digits import digits as proved_digits

        method = cast("Method", self)
        return proved_digits(method, digits, certificate=certificate, embedded=embedded)

    def _repr_html_(self) -> str:
        from ..formats.notebooks import to_html

        return to_html(cast("Method", self))

    def _repr_latex_(self) -> str:
        from ..formats.notebooks import to_formula

        return to_formula(cast("Method", self))
