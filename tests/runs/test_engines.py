"""Searches on Dask, loky and MPI."""

import shutil
import subprocess
import sys

import pytest

import cg
from cg.executors import execution

SEARCH = {"order": 3, "stages": 3, "seed": 5, "starts": 30}
MPI = """
import sys
from mpi4py.futures import MPIPoolExecutor
import cg
if __name__ == "__main__":
    with MPIPoolExecutor() as pool:
        result = cg.search(3, 3, 30, 5, executor=pool, store=sys.argv[1])
        assert result == cg.search(3, 3, 30, 5), "other results"
        print("equal,", pool.num_workers, "workers")
"""


class TestEngines:
    """Searches on clusters that the tests start."""

    def test_dask(self, tmp_path):
        distributed = pytest.importorskip("distributed")
        with (
            distributed.LocalCluster(
                n_workers=2,
                threads_per_worker=1,
                processes=True,
                dashboard_address=":0",  # any port: another cluster may have the usual one
                local_directory=tmp_path,
            ) as cluster,
            distributed.Client(cluster) as client,
            client.get_executor() as pool,
        ):
            result = cg.search(**SEARCH, executor=pool, store=tmp_path / "runs.db")
            assert result == cg.search(**SEARCH)
            assert execution._workers_of(pool) == 2

    def test_loky(self):
        loky = pytest.importorskip("loky")
        result = cg.search(**SEARCH, executor=lambda: loky.get_reusable_executor(2))
        assert result == cg.search(**SEARCH)

    def test_mpi(self, tmp_path):
        pytest.importorskip("mpi4py")
        if not shutil.which("mpiexec"):
            pytest.skip("mpiexec isn't installed")
        script = tmp_path / "run.py"
        script.write_text(MPI)
        command = ["mpiexec", "--oversubscribe", "--allow-run-as-root", "-n", "3", sys.executable]
        process = subprocess.run(
            [*command, "-m", "mpi4py.futures", str(script), str(tmp_path / "runs.db")],
            capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        assert process.stdout == "equal, 2 workers\n", process.stderr
