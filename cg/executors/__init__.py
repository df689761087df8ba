"""Pieces of work on any executor: pools, threads, clusters."""

from cg.executors.execution import ExecutorLike, Finished, as_finished, check_executor, completed

__all__ = ["ExecutorLike", "Finished", "as_finished", "check_executor", "completed"]
