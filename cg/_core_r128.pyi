# The compiled core; its entries are declared in fortran/core.pyf.in.
from typing import Any

def __getattr__(name: str) -> Any: ...
