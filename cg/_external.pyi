# The compiled core; its entries are declared in fortran/external.pyf.
from typing import Any

def __getattr__(name: str) -> Any: ...
