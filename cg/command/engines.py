"""Options that choose the executor of a command: threads, processes, Dask, MPI."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from cg.command.arguments import stacked
from cg.executors import ExecutorLike

engine_options = stacked(
    click.option(
        "--processes", is_flag=True,
        help="Run in processes: a start that kills its worker doesn't end the run.",
    ),
    click.option(
        "--dask", metavar="ADDRESS", help="Run on the workers of a Dask scheduler, tcp://…"
    ),
    click.option(
        "--mpi", is_flag=True,
        help="Run on the processes of mpiexec: mpiexec -n 3 python -m mpi4py.futures -m cg …",
    ),
)  # fmt: skip


@contextmanager
def engine(processes: bool, dask: str | None, mpi: bool) -> Iterator[ExecutorLike]:
    """Yield the executor that the options choose; UsageError for more than one of them."""
    if processes + (dask is not None) + mpi > 1:
        raise click.UsageError("--processes, --dask and --mpi exclude each other")
    if dask is not None:
        distributed = _imported("distributed", "--dask")
        with distributed.Client(dask, timeout="30s") as client, client.get_executor() as executor:
            yield executor
    elif mpi:
        futures = _imported("mpi4py.futures", "--mpi")
        with futures.MPIPoolExecutor() as executor:
            yield executor
    else:
        yield "processes" if processes else None


def _imported(module: str, option: str) -> Any:
    from importlib import import_module

    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise click.UsageError(f"{option} needs the package {package}: {error}") from None
