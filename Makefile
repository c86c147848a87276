# make run    set up and run a Panda at a table with a cube
# make pick   in a second shell: pick the cube up
# make view   in another shell: see and drive it in the browser
# make test   set up and run all tests, four files at a time (TEST_JOBS=4)
# make test-fast  for half a minute those tests that are nearest to what has changed
#                (FAST_ARGS=--help)
# make lint   style, docstrings and types
# make coverage  the same, and which lines no test runs
# make mutate    change 150 places of the code, one by one, and see which changes no test finds
#                (MUTATE_ARGS=--help)
# make bench  how fast the node is, in a table of targets and figures (BENCH_ARGS=--help)
# make docs   build the documentation as a site, build/docs/index.html; a warning is an error
# make requirements  write the versions and hashes of all packages anew, for LOCKED=1
#                    (REQUIREMENTS_ARGS=--upgrade for the newest ones)
# make release  a wheel and its software bill of materials (CycloneDX) in dist/
# make soak   load node and viewer for twenty minutes with malformed messages, floods, stops ...; see a
#             table
#
# With LOCKED=1, such as LOCKED=1 make run, pip installs exactly the versions of requirements/, and
# checks their hashes. They are those of ROS 2 Jazzy from wheels.
#
# With ROS 2 Jazzy sourced, its Python packages are used through a virtual environment with system
# site packages; without it, ROS 2 Jazzy comes from wheels. Never a mix: an environment of the other
# kind is cleared. Otherwise what is installed in an environment stays.

# The node and its clients talk within this machine, unless the environment says otherwise:
# ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET make run  (docs/how_to/security.md)

PYTHON ?= python3
VENV ?= .venv
RUN_ARGS ?= --ros-args -p arena:=table
VIEW_ARGS ?=
PYTEST_ARGS ?=
TEST_JOBS ?= 4
PYTHON_SOURCES = manip_sim test benchmark docs hardware setup.py
# The files begin in the order of test/conftest.py.
TEST_DIST = --numprocesses $(TEST_JOBS) --dist loadfile --no-loadscope-reorder
MUTATE_ARGS ?= --sample 150
SOAK_ARGS ?=
FAST_ARGS ?=
BENCH_ARGS ?=
REQUIREMENTS_ARGS ?=
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# Each of some hundred processes of the tests would compile all modules.
unexport PYTHONDONTWRITEBYTECODE

ifeq ($(ROS_DISTRO),jazzy)
ROS_FROM = sourced
ROS_NOT_FROM = wheels
VENV_ARGS = --system-site-packages
RUN_EXTRAS =
VIEW_EXTRAS = [viewer]
TEST_EXTRAS = [test]
MUTATE_EXTRAS = [test,mutate]
else
ROS_FROM = wheels
ROS_NOT_FROM = sourced
VENV_ARGS =
RUN_EXTRAS = [jazzy]
VIEW_EXTRAS = [jazzy,viewer]
TEST_EXTRAS = [jazzy,jazzy-test,test]
MUTATE_EXTRAS = [jazzy,jazzy-test,test,mutate]
endif

BIN = $(VENV)/bin
READY = $(VENV)/.ready-$(ROS_FROM)
VIEW_READY = $(VENV)/.ready-to-view-$(ROS_FROM)
DOCS_READY = $(VENV)/.ready-for-docs
TEST_READY = $(VENV)/.ready-to-test-$(ROS_FROM)
MUTATE_READY = $(VENV)/.ready-to-mutate-$(ROS_FROM)

# $(call install,EXTRAS,FILE): the package with extras, or what a file of requirements/ locks.
ifeq ($(LOCKED),1)
ifeq ($(ROS_FROM),sourced)
$(error make: LOCKED=1 is for ROS 2 Jazzy from wheels, and another one is sourced)
endif
install = $(BIN)/python -m pip install --require-hashes --requirement requirements/$(2).txt \
	&& $(BIN)/python -m pip install --no-deps --no-build-isolation --editable .
else
install = $(BIN)/python -m pip install --editable '.$(1)'
endif

.PHONY: run pick view test test-fast coverage lint docs bench soak mutate requirements release clean

run: $(READY)
	exec $(BIN)/sim_node $(RUN_ARGS)

pick: $(READY)
	$(BIN)/pick_cube

view: $(VIEW_READY)
	exec $(BIN)/sim_view $(VIEW_ARGS)

test: $(TEST_READY)
	$(BIN)/python -m pytest $(TEST_DIST) $(PYTEST_ARGS)

test-fast: $(TEST_READY)
	$(BIN)/python test/fast.py $(FAST_ARGS)

# Beside the tests, which lines of the package they and the processes that they start run.
coverage: $(TEST_READY)
	rm -f .coverage .coverage.*
	if $(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 12))'; then \
		export COVERAGE_CORE=sysmon; fi; COVERAGE_FILE=$(CURDIR)/.coverage \
		$(BIN)/python -m coverage run -m pytest $(TEST_DIST) $(PYTEST_ARGS)
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

mutate: $(MUTATE_READY)
	$(BIN)/python test/mutation/mutate.py $(MUTATE_ARGS)

lint: $(TEST_READY)
	$(BIN)/python -m ruff check $(PYTHON_SOURCES)
	$(BIN)/python -m flake8 $(PYTHON_SOURCES)
	$(BIN)/python -m mypy
	$(BIN)/python -m mypy benchmark/*.py benchmark/targets/*.py

docs: $(DOCS_READY)
	$(BIN)/python -m sphinx -q -W --keep-going docs build/docs

bench: $(READY)
	$(BIN)/python benchmark/bench.py $(BENCH_ARGS)

soak: $(TEST_READY)
	$(BIN)/python test/soak/soak.py $(SOAK_ARGS)

$(READY): setup.py
	$(PYTHON) -c 'import sys; assert (3, 10) <= sys.version_info < (3, 14), sys.version' \
		|| { echo 'make: set PYTHON to a Python from 3.10 to 3.13' >&2; exit 1; }
	$(PYTHON) -m venv $(if $(wildcard $(VENV)/.ready-$(ROS_NOT_FROM)),--clear) $(VENV_ARGS) $(VENV)
	[ '$(LOCKED)' = 1 ] || $(BIN)/python -m pip install --quiet --upgrade pip setuptools wheel
	$(call install,$(RUN_EXTRAS),run)
	touch $@

$(VIEW_READY): $(READY)
	$(call install,$(VIEW_EXTRAS),run)
	touch $@

$(DOCS_READY): $(READY)
	$(call install,[docs],test)
	touch $@

$(TEST_READY): $(READY)
	$(call install,$(TEST_EXTRAS),test)
	touch $@

$(MUTATE_READY): $(TEST_READY)
	$(call install,$(MUTATE_EXTRAS),test)
	touch $@

# All extras, but not those of hundreds of megabytes that tests do without.
LOCKED_EXTRAS = docs env jazzy jazzy-test meshes mutate onnx records run test viewer xacro
# For all Pythons at once, users and tests with the same versions.
COMPILE = $(BIN)/uv pip compile --quiet --universal --python-version 3.10 --generate-hashes \
	--no-annotate --custom-compile-command 'make requirements' $(REQUIREMENTS_ARGS) setup.py

requirements: $(READY)
	$(BIN)/python -m pip install --quiet uv
	$(COMPILE) $(LOCKED_EXTRAS:%=--extra %) --output-file requirements/test.txt
	$(COMPILE) --extra jazzy --extra viewer --extra records --constraint requirements/test.txt \
		--output-file requirements/run.txt

release: $(TEST_READY)
	rm -rf dist
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .
	$(BIN)/python -m cyclonedx_py requirements requirements/run.txt \
		--output-reproducible --output-format JSON --output-file dist/manip_sim.cdx.json

clean:
	rm -rf $(VENV) build install log *.egg-info
