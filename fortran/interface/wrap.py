"""Write the C wrapper of an extension module for the procedures of Fortran sources.

f2py reads their signatures itself. The procedures have binding labels, so that they are called as
if they belonged to no module. In sources of the wide kind real numbers become 16 bytes each, which
are never a C type; ``inout`` is the one intent with which f2py never copies, so that a flag set
during a call is seen.
"""

import io
import re
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
from numpy import f2py

_KINDS = """{
    "real": {"wp": "double", "real64": "double"},
    "logical": {"c_bool": "signed_char"},
    "integer": {"int64": "long_long", "c_int64_t": "long_long", "c_intptr_t": "long_long",
                "int8": "signed_char"},
}
"""


def main(folder: Path, name: str, wide: bool, sources: list[Path]) -> None:
    """Write the wrapper of the module of a name into a folder."""
    kinds, signatures = folder / f"{name}.f2cmap", folder / f"{name}.pyf"
    kinds.write_text(_KINDS, encoding="utf-8")
    options = ["--quiet", "--lower", "--f2cmap", str(kinds), "--build-dir", str(folder)]
    copies = []
    for source in sources:
        copies.append(folder / f"{name}_{source.name}")
        text = source.read_text(encoding="utf-8")
        copies[-1].write_text(in_bytes(text) if wide else text, encoding="utf-8")
    header = ["-h", signatures.name, "--overwrite-signature", "-m", name]
    with redirect_stdout(io.StringIO()):  # it prints all statements `use, intrinsic`
        f2py.run_main([*options, *header, *map(str, copies)])
    text = re.sub(r"(?m)^ *(use|(end )?module) .*\n", "", signatures.read_text(encoding="utf-8"))
    aligned = re.sub(r"(dimension\(16,.*intent\((?:in|out))", r"\1,aligned16", text)
    signatures.write_text(aligned, encoding="utf-8")
    if np.lib.NumpyVersion(np.__version__) >= "2.1.0":
        # compiled code has no state that threads share, so that it needs no global lock
        options.append("--freethreading-compatible")
    f2py.run_main([*options, str(signatures)])


def in_bytes(text: str) -> str:
    """Return sources in which arrays of real numbers, one statement a line, are those of bytes."""
    return re.sub(
        r"real\(wp\)(, intent.*)",
        lambda match: "integer(int8)" + re.sub(r"(\w)\((\w+)", r"\1(16, \2", match[1]),
        text,
    ).replace("intent(16, ", "intent(")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3] == "wide", list(map(Path, sys.argv[4:])))
