"""Files of methods, in TOML, or in JSON with the same keys."""

import json
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path
from typing import Any

from cg.construction.methods.coefficients import Coefficient, read_row
from cg.construction.methods.commutator_free import CommutatorFree, MuntheKaas
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.splitting import Splitting
from cg.construction.methods.tableau import Tableau, TableauError
from cg.construction.points import MethodError
from cg.support.parsing import check_keys, quoted, read_file, read_json, read_toml, write_file

_SUFFIXES = (".toml", ".json")

_KIND, _MAGNUS, _SPLITTING = "Munthe-Kaas", "Magnus", "splitting"
_POINTS, _TABLEAU = "points", "tableau"  # files without the key kind
_KEYS_OF_POINTS = {"points", "stage_points", "result"}  # not in files of tableaux
_KEYS = {
    _KIND: ({"kind", "a", "b"}, {"b_embedded", "b_third"}),
    _MAGNUS: ({"kind", "nodes", "weights"}, {"brackets", "embedded", "b_third", "third_factor"}),
    _SPLITTING: ({"kind", "drifts", "kicks"}, set[str]()),
    _POINTS: (_KEYS_OF_POINTS, {"embedded_result", "b_third", "nominal"}),
    _TABLEAU: ({"a", "b"}, {"b_embedded", "nominal"}),
}
"""The keys that a file must and may have beside its name, source and recipe."""

_FILE_NAME = re.compile(r"[^./\\\0][^/\\\0]*")
_STAGE = re.compile(r"\d{1,6}", re.ASCII)


def loads(text: str) -> Method:
    """Read a method from the text of a catalogue file: TOML, or JSON with the same keys."""
    if not isinstance(text, str):
        raise TypeError(f"text must be a str, got {text!r}")
    return from_entry(read_entry(text))


def from_entry(entry: dict[str, Any], name: str = "") -> Method:
    """Return the method of the keys of a file; ``name``, ``source`` and ``c`` are optional.

    ``recipe`` says how the method was found, see `research/run_recipe.py`; the method lacks it.
    """
    entry = {"source": ""} | entry | {"name": entry.get("name") or name}
    c = entry.pop("c", None)
    if not isinstance(entry.pop("recipe", ""), str | dict):
        raise TableauError("recipe must be a text or a table with one call")
    method = _from_entry(entry)
    if c is not None:
        for problem in wrong_abscissae(method, c):
            raise TableauError(problem)
    return method


def wrong_abscissae(method: Method, c: Sequence[Any]) -> Iterator[str]:
    """Yield a sentence for each abscissa that isn't the sum of its row, up to rounding.

    MethodError unless there is one for each stage.
    """
    abscissae = read_row(c, "c", method.stages, "c_{}")
    for i, (expected, total) in enumerate(zip(abscissae, method.abscissae, strict=True), 1):
        # the uncertainties of the entries add up
        allowed = expected.unit + sum((k.unit for k in method.coefficients), Fraction(0))
        if abs(expected.value - total) > allowed:
            yield (
                f"row {i} of a sums to {_short(total)}, not to c_{i} = {expected.text}: "
                f"off by {float(total - expected.value):.3g}"
            )


def _short(value: Fraction) -> str:
    # Python may be unable to write a longer one
    text = str(value) if value.denominator.bit_length() <= 64 else ""
    return text if 0 < len(text) <= 12 else f"{float(value):.16g}"


def _from_entry(entry: dict[str, Any]) -> Method:
    kind = entry.get("kind", _TABLEAU if _KEYS_OF_POINTS.isdisjoint(entry) else _POINTS)
    if "kind" in entry and kind not in (_KIND, _MAGNUS, _SPLITTING):
        kinds = f"{_KIND!r}, {_MAGNUS!r} or {_SPLITTING!r}"
        raise MethodError(f"kind must be {kinds}, got {kind!r}")
    required, optional = _KEYS[kind]
    check_keys(entry, {"name", "source", *required}, optional, "the entry", TableauError)
    entry.pop("kind", None)
    third = {"third": entry.pop("b_third")} if "b_third" in entry else {}
    if kind == _MAGNUS:
        return MagnusMethod(entry.pop("nodes"), entry.pop("weights"), **third, **entry)
    if kind == _SPLITTING:
        return Splitting(**entry)
    nominal: dict[str, Any] = {}
    if "nominal" in entry:
        table = entry.pop("nominal")
        if not isinstance(table, dict):
            raise TableauError(f"nominal must be a table, got {table!r}")
        check_keys(table, {"order", "residual"}, (), "nominal", TableauError)
        nominal = {f"nominal_{key}": value for key, value in table.items()}
    if kind == _POINTS:
        return CommutatorFree(_read_points(entry.pop("points")), **third, **entry, **nominal)
    tableau = Tableau(entry.pop("a"), entry.pop("b"), **entry, **nominal)
    return MuntheKaas(tableau, **third) if kind == _KIND else tableau


def read_entry(text: str, name: str = "") -> dict[str, Any]:
    """Return the keys and values of a catalogue file: TOML, or JSON with the same keys."""
    text = text.removeprefix("\ufeff")  # a byte-order mark
    if name.lower().endswith(".json") or text.lstrip().startswith("{"):  # as no line of TOML does
        return read_json(text, TableauError)
    return read_toml(text, TableauError, parse_float=str)


def _read_points(tables: Any) -> list[Any]:
    if not isinstance(tables, list):
        raise MethodError(f"points must be an array of tables, got {tables!r}")
    points = []
    for m, table in enumerate(tables):
        if not isinstance(table, dict) or not isinstance(table.get("weights", {}), dict):
            raise MethodError(f"point {m} must be a table with one of weights, got {table!r}")
        check_keys(table, {"parent", "weights"}, (), f"point {m}", TableauError)
        stages = table["weights"]
        if wrong := [stage for stage in stages if not _STAGE.fullmatch(stage)]:
            raise MethodError(f"weights of point {m} must be on stages, got one on {wrong[0]!r}")
        points.append((table["parent"], {int(k): weight for k, weight in stages.items()}))
    return points


def load(path: str | PathLike[str]) -> Method:
    """Read a method from a file, in TOML or JSON.

    A certificate beside the file proves digits beyond the stored ones; see `cg.digits`.

    Raises
    ------
    TypeError
        If `path` isn't a path.
    MethodError
        If the file holds no method; the message names the file.
    OSError
        If the file can't be read.

    Examples
    --------
    >>> import crouch_grossman as cg, tempfile
    >>> file = tempfile.mkdtemp() + "/mine.toml"
    >>> cg.save(cg.Tableau([[], ["2/3"]], ["1/4", "3/4"], name="Ralston"), file)
    >>> cg.load(file)
    <Tableau Ralston: order 2, 2 evaluations, 3 flows>
    """
    path = check_path(path)
    method = read(path)
    object.__setattr__(method, "file", path.absolute())
    return method


def is_file(text: str) -> bool:
    """Return whether a text is a file path rather than a name in the catalogue."""
    return text.lower().endswith(_SUFFIXES) or os.sep in text


def certificate_path(file: Path) -> Path:
    """Return the certificate beside the file of a method, or in a folder ``certificates`` there."""
    in_folder = file.parent / "certificates" / f"{file.stem}.toml"
    return in_folder if in_folder.is_file() else file.with_name(file.stem + ".certificate.toml")


def check_path(path: str | PathLike[str]) -> Path:
    """Return `path` as a Path; TypeError if it isn't a path."""
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path must be a path, got {path!r}")
    return Path(path)


def read(path: Traversable) -> Method:
    """Read a method from a file, which may be in a package; errors name the file."""
    with errors_naming(path):
        entry = read_entry(read_file(path, TableauError), path.name)
        return from_entry(entry, path.name.rpartition(".")[0])


@contextmanager
def errors_naming(path: Any) -> Iterator[None]:
    """Begin the messages of errors about a file's content with its path."""
    try:
        yield
    except MethodError as error:
        raise type(error)(f"{path}: {error}") from None


def dumps(method: Method) -> str:
    """Return a method as the text of a TOML file; `loads` returns an equal method."""
    lines = []
    if isinstance(method, Tableau | MuntheKaas):
        rows = method.layout.cut(method.coefficients)
        lines += _block("a", rows[: method.stages])
        for label, row in zip(("b", "b_embedded"), rows[method.stages :], strict=False):
            lines.append(f"{label} = {_array(row)}")
        if isinstance(method, MuntheKaas):
            lines.insert(0, f"kind = {quoted(_KIND)}")
    elif isinstance(method, CommutatorFree):
        lines.append("points = [")
        for point, weights in zip(method.points, method.point_coefficients, strict=True):
            texts = ", ".join(f"{stage} = {quoted(w.text)}" for stage, w in weights.items())
            lines.append(f"  {{parent = {point.parent}, weights = {{{texts}}}}},")
        lines += ["]", f"stage_points = {list(method.stage_points)}", f"result = {method.result}"]
        if method.embedded_result is not None:
            lines.append(f"embedded_result = {method.embedded_result}")
    elif isinstance(method, MagnusMethod):
        factor = quoted(method.third_factor.text)
        lines += [f"kind = {quoted(_MAGNUS)}", f"third_factor = {factor}"]
        lines.append(f"nodes = {_array(method.nodes)}")
        if method.brackets:
            pairs = [f"[{', '.join(map(_array, pair))}]" for pair in method.brackets]
            lines += ["brackets = [", *(f"  {pair}," for pair in pairs), "]"]
        lines += [*_block("weights", method.weights), *_block("embedded", method.embedded_weights)]
    elif isinstance(method, Splitting):
        lines.append(f"kind = {quoted(_SPLITTING)}")
        lines.append(f"drifts = {_array(method.drift_coefficients)}")
        lines.append(f"kicks = {_array(method.kick_coefficients)}")
    else:
        kinds = "Tableau, CommutatorFree, MuntheKaas, MagnusMethod or Splitting"
        raise TypeError(f"method must be a {kinds}, got {method!r}")
    if (third := method.third_weights) is not None:
        lines.append(f"b_third = {_array(third)}")
    if method.nominal_residual is not None:
        lines += ["", "[nominal]", f"order = {method.nominal_order}"]
        lines.append(f"residual = {quoted(method.nominal_residual.text)}")
    head = [f"name = {quoted(method.name)}", f"source = {quoted(method.source)}"]
    return "\n".join([*head, *lines]) + "\n"


def dumps_json(method: Method) -> str:
    """Return a method as JSON, which `loads` reads."""
    return json.dumps(read_toml(dumps(method), MethodError), indent=2) + "\n"


def _block(label: str, rows: Sequence[Sequence[Coefficient]] | None) -> list[str]:
    return [] if rows is None else [f"{label} = [", *(f"  {_array(row)}," for row in rows), "]"]


def _array(row: Sequence[Coefficient]) -> str:
    return "[" + ", ".join(quoted(coefficient.text) for coefficient in row) + "]"


def save(method: Method, path: str | PathLike[str]) -> None:
    """Write a method to a file: JSON if its name ends in ``.json``, else TOML.

    Parameters
    ----------
    method
    path
        The file, or a folder, in which the file is ``NAME.toml`` with the name of the method.

    Raises
    ------
    OSError
        If the file can't be written.

    Examples
    --------
    >>> import crouch_grossman as cg, tempfile
    >>> cg.save(cg.methods["CG3"], tempfile.mkdtemp())
    """
    path = check_path(path)
    if path.is_dir():
        if not _FILE_NAME.fullmatch(method.name):  # a file elsewhere, or a hidden one
            raise ValueError(f"name must be fit for a file's name, got {method.name!r}")
        path /= f"{method.name}.toml"
    write_file(path, dumps_json(method) if path.suffix.lower() == ".json" else dumps(method))
