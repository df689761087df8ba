# The compiled core; its entries are declared in fortran/interface/core.pyf.in.
from typing import Any

def __getattr__(name: str) -> Any: ...
