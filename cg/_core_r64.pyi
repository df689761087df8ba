# The compiled core, whose procedures are those of fortran/interface/api*.f90.
from typing import Any

def __getattr__(name: str) -> Any: ...
