"""Write the C wrapper of an extension module from a signature file of f2py.

The signatures of the procedures of Fortran sources, which f2py reads itself, are added to it. These
procedures have binding labels, so that they are called as if they belonged to no module.
"""

import io
import re
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
from numpy import f2py

_KINDS = """{
    "real": {"wp": "double"},
    "logical": {"c_bool": "signed_char"},
    "integer": {"int64": "long_long", "c_int64_t": "long_long", "c_intptr_t": "long_long"},
}
"""


def main(folder: Path, signatures: Path, sources: list[str]) -> None:
    """Write the wrapper into a folder; modules with sources must have real(8) as ``wp``."""
    text = signatures.read_text(encoding="utf-8")
    kinds, complete = folder / f"{signatures.stem}.f2cmap", folder / f"{signatures.stem}_all.pyf"
    kinds.write_text(_KINDS, encoding="utf-8")
    options = ["--quiet", "--lower", "--f2cmap", str(kinds), "--build-dir", str(folder)]
    if sources:
        header = ["-h", complete.name, "--overwrite-signature", "-m", "sources"]
        with redirect_stdout(io.StringIO()):  # it prints all statements `use, intrinsic`
            f2py.run_main([*options, *header, *sources])
        lines = complete.read_text(encoding="utf-8").split("\n")
        first, last = (
            next(k for k, line in enumerate(lines) if re.match(rf" *{start}\b", line))
            for start in ("interface", "end interface")
        )
        own = [
            line
            for line in lines[first + 1 : last]
            if not re.match(r" *(use|(end )?module) ", line)
        ]
        before, end, after = text.rpartition("  end interface")
        text = "\n".join([before, *own, end + after])
    complete.write_text(text, encoding="utf-8")
    if np.lib.NumpyVersion(np.__version__) >= "2.1.0":
        # compiled code has no state that threads share, so that it needs no global lock
        options.append("--freethreading-compatible")
    f2py.run_main([*options, str(complete)])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
