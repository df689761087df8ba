"""Numbers that Python and the compiled core must agree on: one table, of which Fortran is made.

The build runs this file to write the Fortran module ``shared_numbers``, in which a member of an
enumeration has its own name in lower case, followed by the suffix of the enumeration.
"""

from __future__ import annotations

import argparse
from enum import IntEnum
from pathlib import Path

__all__ = ["BlockKind", "BlockOption", "Stop", "fortran_module"]


class Stop(IntEnum):
    """Why the compiled loop over steps came back."""

    FINISHED = 0
    STOPPED_BY_FIELD = 1  # it returned a nonzero flag
    FIELD_NOT_FINITE = 2
    STAGE_NOT_FINITE = 3  # the point that the field was given
    SOLUTION_NOT_FINITE = 4
    OUT_OF_MEMORY = 5
    PAUSED = 6  # to be called again
    STEP_TOO_SMALL = 7
    SLOPE_NOT_FINITE = 8  # relative to the tolerances


class FieldFlag(IntEnum):
    """What a right-hand side may return that is not a number of its own."""

    RAISED_IN_PYTHON = -(2**31) + 1


class BlockKind(IntEnum):
    """What a block of a compiled frame is."""

    EUCLIDEAN = 1  # R^n with the fields d/dx_i
    SO3 = 2  # rotation matrices, row by row
    QUATERNION = 3  # unit quaternions that turn by v
    SE3 = 4  # 4 x 4 matrices of rigid motions, row by row
    SPHERE = 5  # the sphere in R^3: y' = v x y
    SU2 = 6  # complex 2 x 2 matrices, row by row


class BlockOption(IntEnum):
    """Options of a block, which add up."""

    SPACE_AXES = 1  # v acts from the left, not in body axes
    SCALAR_FIRST = 2  # of a quaternion


_SUFFIXES = {Stop: "", FieldFlag: "", BlockKind: "_block", BlockOption: ""}


def fortran_module() -> str:
    """Return the Fortran module that has all members as parameters."""
    lines = [
        "! Made from cg/shared_numbers.py",
        "module shared_numbers",
        "  implicit none",
        "  public",
    ]
    for enumeration, suffix in _SUFFIXES.items():
        for member in enumeration:
            name = member.name.lower() + suffix
            lines.append(f"  integer, parameter :: {name} = {member.value}")
    return "\n".join([*lines, "end module shared_numbers", ""])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, required=True)
    parser.parse_args().output.write_text(fortran_module(), encoding="utf-8")
