"""Results of long runs: distinct solutions, the best ones, families, published methods."""

from cg.construction.results.publishing import Publication, publish
from cg.construction.results.solutions import StoredSolution, best, families, solutions

__all__ = ["Publication", "StoredSolution", "best", "families", "publish", "solutions"]
