# `make reproduce` and `make test` also install all they need on a fresh Debian or Ubuntu machine.
VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed
PEERS := $(VENV)/.peers
ALL_PEERS := $(VENV)/.all-peers
# a test that hangs fails, and a worker that is idle takes over waiting tests of another one
PYTEST := -m pytest --numprocesses auto --dist worksteal --timeout 900
OUT ?=
ARGS ?=

.PHONY: all build reproduce test test-all test-checks test-sanitize test-oldest lint benchmarks catalogue reference-steps mutants docs wheel release clean

all: build

$(STAMP): pyproject.toml tools/prerequisites.sh
	@sh tools/prerequisites.sh
	python3 -m venv $(VENV)
	$(PY) -m pip install --quiet --upgrade pip
	$(PY) -m pip install --quiet "meson-python>=0.18" "meson>=1.4" ninja "numpy>=2.0"
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(PY) -m pip install --quiet --no-build-isolation --editable ".[test,dev]"
	@touch $(STAMP)

build: $(STAMP)
	@$(PY) -c "import cg"

reproduce: build
	$(VENV)/bin/reproduce-paper $(if $(OUT),--out $(OUT)) $(ARGS)

# packages that tests compare results with; without them these tests are skipped
$(PEERS): $(STAMP) tools/peers.sh
	@sh tools/peers.sh $(PY)
	@touch $@

# those of few tests, and Debian's
$(ALL_PEERS): $(PEERS)
	@sh tools/peers.sh $(PY) rest
	@touch $@

test: build $(PEERS)
	$(PY) $(PYTEST) -m "not slow" $(ARGS)

test-all: build $(ALL_PEERS)
	$(PY) $(PYTEST) $(ARGS)

# a second environment with run-time checks in the compiled core; tests that add nothing for the core
# are left out
test-checks:
	@sh tools/prerequisites.sh
	test -d $(VENV)-checks || python3 -m venv $(VENV)-checks
	$(VENV)-checks/bin/python -m pip install --quiet "meson-python>=0.18" "meson>=1.4" ninja "numpy>=2.0"
	PATH="$(CURDIR)/$(VENV)-checks/bin:$$PATH" $(VENV)-checks/bin/python -m pip install --quiet \
		--no-build-isolation -Cbuild-dir=build/checks -Csetup-args=-Dchecks=true --editable ".[test]"
	$(VENV)-checks/bin/python $(PYTEST) -m "not slow and not no_core" $(ARGS)

# the core with the address and undefined-behaviour sanitizers
test-sanitize: build $(ALL_PEERS)
	sh tools/sanitized.sh $(PY) --numprocesses auto -m "sanitize and not slow" $(ARGS)

# the tests with the oldest versions that pyproject.toml admits, without the packages to compare with;
# old packages may cause deprecation warnings
test-oldest:
	@sh tools/prerequisites.sh
	test -d $(VENV)-oldest || python3 -m venv $(VENV)-oldest
	python3 tools/oldest.py | $(VENV)-oldest/bin/python -m pip install --quiet \
		"meson-python>=0.18" "meson>=1.4" ninja --requirement /dev/stdin
	PATH="$(CURDIR)/$(VENV)-oldest/bin:$$PATH" $(VENV)-oldest/bin/python -m pip install --quiet \
		--no-build-isolation --no-deps -Cbuild-dir=build/oldest --editable .
	$(VENV)-oldest/bin/python $(PYTEST) -m "not slow" \
		-W default::DeprecationWarning $(ARGS)

benchmarks: build
	$(PY) -m benchmarks $(ARGS)

catalogue: build
	$(PY) tools/update_catalogue.py
	$(PY) tools/compile_tables.py
	$(PY) tools/make_reference_steps.py

reference-steps: build
	$(PY) tools/make_reference_steps.py

# plants errors in a clone, and says which of them the tests see
PLANTED := $(CURDIR)/build/planted
mutants: build
	test -f $(PLANTED)/errors.json || $(PY) tools/plant_errors.py plant $(ARGS)
	$(MAKE) --directory $(PLANTED) --silent build
	cd $(PLANTED) && .venv/bin/python $(CURDIR)/tools/plant_errors.py see
	$(PY) tools/plant_errors.py show

lint: build
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

# the site, in build/site; warnings and broken internal links are errors
docs: build
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(PY) -m pip install --quiet --no-build-isolation --editable ".[docs]"
	$(PY) -m sphinx --builder html --fail-on-warning --keep-going --quiet --doctree-dir build/doctrees docs build/site
	$(PY) docs/check_site.py build/site

# sdist and wheel in dist/, tested in a new environment without Fortran libraries
wheel:
	sh tools/wheel.sh dist

# builds, checks and lists what would be published
release: build wheel
	$(PY) -m pip install --quiet twine
	$(PY) tools/release.py dist

clean:
	rm -rf build dist $(VENV) $(VENV)-checks $(VENV)-oldest reproduce/out
