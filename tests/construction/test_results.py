"""Results of runs: distinct solutions, the best ones, and published methods."""

import json
import sqlite3
import sys
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.command import main
from cg.construction.candidate import Candidate
from cg.construction.proofs.files import certificate_beside
from cg.construction.results import best, families, publish, solutions
from cg.construction.results.solutions import OBJECTIVES, connected
from cg.construction.runs import Store
from cg.construction.solvers.singular import decompose, retract


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "runs.db"
    cg.search(3, 3, 40, 1, store=path)
    cg.search(4, 5, 12, 2, flows=6, store=path)
    cg.construct(4, 5, seed=3, store=path)
    cg.search(4, 4, 3, 1, store=path, force=True)  # there are none
    return path


@pytest.fixture
def store(path):
    with Store(path) as opened:
        yield opened


def test_solutions_are_the_methods_of_the_search(store):
    starts = list(solutions(store.run(1)))
    methods = cg.search(3, 3, 40, 1).methods
    assert len(starts) == len(methods) > 10
    largest = sorted(one.candidate.largest for one in starts)
    np.testing.assert_allclose(
        largest, [max(abs(float(c.value)) for c in method.coefficients) for method in methods]
    )
    assert {one.candidate.system.layout.stages for one in solutions(store.run(3))} == {5}
    assert not list(solutions(store.run(4)))


@pytest.mark.parametrize("run", [1, 2, 3])
@pytest.mark.parametrize("objective", OBJECTIVES)
def test_best_solutions_come_first(store, run, objective):
    starts = best(store.run(run), objective, 3)
    values = [one.objective(objective) for one in solutions(store.run(run))]
    assert [one.objective(objective) for one in starts] == sorted(values)[:3]


def test_connected_solutions_are_one_family(store):
    first = next(solutions(store.run(1)))
    candidate = first.candidate
    system, x = candidate.system, candidate.x
    for _ in range(12):  # away from there along the set
        near = decompose(system.jacobian(x)[:, system.movable])
        assert near.kernel.shape[1] == 1  # six unknowns, five conditions
        trial = x.copy()
        trial[system.movable] += 0.05 * near.kernel[:, 0] * np.sign(near.kernel[0, 0])
        x = retract(system, trial, system.movable, near)
        assert x is not None
    moved = Candidate(system, x)
    assert np.linalg.norm(moved.x - candidate.x) > 0.1
    assert connected(candidate, moved)
    assert connected(moved, candidate)
    other = replace(first, candidate=moved)
    assert families([first, other]) == [[first, other]]


def test_families_are_components(store):
    starts = list(solutions(store.run(1)))
    groups = families(starts)
    assert sum(map(len, groups)) == len(starts)
    assert 1 < len(groups) < len(starts) / 2  # some walks arrive, not all
    assert [len(group) for group in groups] == sorted(map(len, groups), reverse=True)
    assert families([]) == []


def test_solutions_of_other_shapes_are_not_connected(store):
    one, two = next(solutions(store.run(1))), next(solutions(store.run(3)))
    assert not connected(one.candidate, two.candidate)


@pytest.mark.parametrize("run", [1, 2, 3])
def test_publish_run(store, run, tmp_path):
    publication = publish(store.run(run), "Mine", tmp_path)
    assert publication.method.exact
    assert publication.method.order == {1: 3, 2: 4, 3: 4}[run]
    assert publication.principal_error < publication.initial_principal_error
    assert publication.certificate is not None, publication.reason
    assert [path.name for path in publication.files] == ["Mine.toml", "Mine.certificate.toml"]
    assert cg.construction.catalogue.load(publication.files[0]) == publication.method
    proof = cg.construction.proofs.Certificate.load(publication.files[1])
    cg.construction.proofs.check(proof, publication.method)


def test_publish_without_optimisation(store, tmp_path):
    starts = list(solutions(store.run(1)))[-1]
    publication = publish(
        store.run(1), "Plain", tmp_path, number=starts.start.number, max_iterations=0
    )
    assert f"start {starts.start.number}" in publication.method.source
    x = np.array([float(entry.value) for entry in publication.method.coefficients])
    np.testing.assert_allclose(x, starts.candidate.x, atol=1e-15)
    assert publication.principal_error == publication.initial_principal_error


def test_publish_rejects_bad_arguments(store, tmp_path):
    with pytest.raises(ValueError, match="run 4 has no start that led to a method"):
        publish(store.run(4), "None", tmp_path)
    refuses(ValueError, "number must", publish, store.run(1), "None", tmp_path, number=10**6)
    refuses(ValueError, "fit for a file's name", publish, store.run(1), "../up", tmp_path)
    (tmp_path / "There.toml").write_text("")
    refuses(ValueError, "name must", publish, store.run(1), "There", tmp_path)
    refuses(NotADirectoryError, "folder must", publish, store.run(1), "New", tmp_path / "none")
    refuses(ValueError, "objective must", best, store.run(1), "beauty")
    refuses(ValueError, "count must", best, store.run(1), count=0)


def test_decades(store):
    counts = store.run(1).decades()
    assert sum(counts.values()) == 40
    assert min(counts) < -60
    assert list(counts) == sorted(counts)
    assert max(store.run(4).decades()) > -10


class TestFromAStoreToTheCatalogue:
    """A published method has a name, a certificate and a page, like those of the package."""

    @pytest.mark.filterwarnings("error")
    def test_a_method_of_the_user(self, store, tmp_path, capsys):
        result = best(store.run(1), "principal_error", 1)[0]
        publication = publish(store.run(1), "Mine", tmp_path, number=result.start.number)
        file = str(tmp_path / "Mine.toml")
        assert cg.load(file) == publication.method
        assert certificate_beside(file, publication.method) == publication.certificate
        assert cg.digits(publication.method, 60, certificate=publication.certificate) is not None
        assert main(["show", file, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["certificate"] == str(publication.certificate)
        assert main(["certify", file]) == 0
        assert main(["export", file, "json", "--digits", "60"]) == 0

    def test_publish_into_catalogue_folder(self, store, tmp_path, monkeypatch):
        folder = tmp_path / "catalogue"
        (folder / "certificates").mkdir(parents=True)
        publication = publish(store.run(2), "CF4z", folder)
        assert publication.files == (folder / "CF4z.toml", folder / "certificates" / "CF4z.toml")
        catalogue = cg.construction.catalogue.Catalogue(folder)
        assert catalogue["CF4z"] == publication.method
        cg.construction.proofs.check(
            cg.construction.proofs.Certificate.load(publication.files[1]), publication.method
        )

    def test_publish_with_partial_certificate(self, store, tmp_path, monkeypatch):
        module = sys.modules["cg.construction.results.publishing"]
        partial = cg.construction.proofs.certificate_of(cg.methods["CG5a"])
        monkeypatch.setattr(module, "certify", lambda method: partial)
        publication = publish(store.run(1), "Part", tmp_path)
        assert publication.certificate is partial
        assert publication.reason == partial.statement
        assert len(publication.files) == 2

    def test_publish_rejects_names_of_the_package(self, store, tmp_path):
        for name in ("CF4", "RKMK4"):
            with pytest.raises(ValueError, match=f"'{name}', a method of the package"):
                publish(store.run(1), name, tmp_path)
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("change", [
    "UPDATE starts SET solved = 1",
    "UPDATE starts SET coefficients = zeroblob(length(coefficients)) WHERE solved",
])  # fmt: skip
def test_rejects_records_that_are_no_solutions(change, tmp_path):
    path = tmp_path / "runs.db"
    cg.search(order=4, stages=5, starts=12, seed=0, algorithm="lmdif", store=path)
    with Store(path) as opened:
        assert all(one.start.solved for one in solutions(opened.run(1)))
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(change)
        connection.commit()
    with (
        Store(path) as opened,
        pytest.raises(ValueError, match=r"start \d+ of run 1 in .* is recorded as a solution, but"),
    ):
        list(solutions(opened.run(1)))
