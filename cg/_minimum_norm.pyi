# The compiled core; its entries are declared in fortran/minimum_norm.pyf.
from typing import Any

def __getattr__(name: str) -> Any: ...
