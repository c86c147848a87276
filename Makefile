# make run    set up and run a Panda at a table with a cube
# make pick   in a second shell: pick the cube up
# make view   in another shell: see and drive it in the browser
# make test   set up and run the tests that everyone runs before a commit: less than four minutes
#             on two cores, four files at a time (TEST_JOBS=4)
# make test-full  all tests: every robot, files and records of others, documents, browser, installation
# make lint   style, docstrings and types
# make coverage  all tests, and which lines no test runs
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
# With ROS 2 Jazzy, Kilted or Lyrical sourced, its Python packages are used through a virtual
# environment with system site packages; without it, ROS 2 comes from wheels, those of Jazzy, or of
# Kilted with WHEELS=kilted. Never a mix: an environment of another kind is cleared. Otherwise what is
# installed in an environment stays: what a target needs besides is added, and the package is installed
# once.

# The node and its clients talk within this machine, unless the environment says otherwise:
# ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET make run  (docs/how_to/security.md)

PYTHON ?= python3
VENV ?= .venv
RUN_ARGS ?= --ros-args -p arena:=table
VIEW_ARGS ?=
PYTEST_ARGS ?=
TEST_JOBS ?= 4
PYTHON_SOURCES = manip_sim lerobot_env_manip_sim lerobot_robot_manip_sim test benchmark docs hardware setup.py
# The files begin in the order of test/conftest.py.
TEST_DIST = --numprocesses $(TEST_JOBS) --dist loadfile --no-loadscope-reorder
MUTATE_ARGS ?= --sample 150
SOAK_ARGS ?=
BENCH_ARGS ?=
REQUIREMENTS_ARGS ?=
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# Each of some hundred processes of the tests would compile all modules.
unexport PYTHONDONTWRITEBYTECODE

WHEELS ?= jazzy
# Files in an environment say which ROS it has: wheels are those of Jazzy.
ROS_KINDS = wheels kilted sourced
ifneq ($(filter $(ROS_DISTRO),jazzy kilted lyrical),)
ROS_FROM = sourced
VENV_ARGS = --system-site-packages
RUN_EXTRAS = viewer
TEST_EXTRAS = docs,mutate,test
else
ifeq ($(filter $(WHEELS),jazzy kilted),)
$(error make: WHEELS is jazzy or kilted, got '$(WHEELS)')
endif
ROS_FROM = $(if $(filter jazzy,$(WHEELS)),wheels,$(WHEELS))
VENV_ARGS =
RUN_EXTRAS = $(WHEELS),viewer
TEST_EXTRAS = docs,$(WHEELS)-test,mutate,test
endif
ROS_NOT_FROM = $(filter-out $(ROS_FROM),$(ROS_KINDS))

BIN = $(VENV)/bin
READY = $(VENV)/.ready-$(ROS_FROM)
TEST_READY = $(VENV)/.ready-to-test-$(ROS_FROM)

# $(call install,NAME,ARGUMENTS): let pip install, and show in one line what it does; all if it fails.
define install
@echo 'Installing $(1) into $(VENV), once'; \
$(BUILT_WITH) $(BIN)/python -m pip install --progress-bar off $(2) > $(VENV)/pip.log 2>&1 & pip=$$!; seconds=0; \
while kill -0 $$pip 2> /dev/null; do sleep 1; seconds=$$((seconds + 1)); [ ! -t 1 ] || \
	printf '\r\033[K  %s s  %.60s' $$seconds "$$(grep -v '^ *Using' $(VENV)/pip.log | tail -n 1)"; done; \
[ ! -t 1 ] || printf '\r\033[K'; \
wait $$pip || { cat $(VENV)/pip.log; exit 1; }
endef

# The packages of an extra, or what a file of requirements/ locks.
ifeq ($(LOCKED),1)
ifneq ($(ROS_FROM),wheels)
$(error make: LOCKED=1 is for ROS 2 Jazzy from wheels, not for $(or $(filter-out sourced,$(ROS_FROM)),what is sourced))
endif
RUN_PACKAGES = --require-hashes --requirement requirements/run.txt
TEST_PACKAGES = --require-hashes --requirement requirements/test.txt
# What builds packages that come without a wheel has no hashes, but a version; pip has the second
# name for it since 25.3.
PREPARE = .ci/constraints test > $(VENV)/locked.txt
BUILT_WITH = PIP_CONSTRAINT=$(VENV)/locked.txt PIP_BUILD_CONSTRAINT=$(VENV)/locked.txt
else
PREPARE = $(BIN)/python -m pip install --quiet --upgrade pip setuptools wheel
RUN_PACKAGES = --editable '.[$(RUN_EXTRAS)]'
# The package that is installed stays as it is, whatever runs with it.
TEST_PACKAGES = 'manip_sim[$(TEST_EXTRAS)]'
endif

PYTEST = $(BIN)/python -m $(if $(COVER),coverage run -m )pytest $(TEST_DIST)

.PHONY: run pick view test test-full coverage coverage-report lint docs bench soak mutate requirements release clean

run: $(READY)
	exec $(BIN)/sim_node $(RUN_ARGS)

# A program beside a node takes the environment as it is, also if setup.py is newer: pip would change
# it under the node.
AS_IT_IS = $(if $(wildcard $(READY)),,$(READY))

pick: $(AS_IT_IS)
	$(BIN)/pick_cube

view: $(AS_IT_IS)
	exec $(BIN)/sim_view $(VIEW_ARGS)

test: $(TEST_READY)
	$(PYTEST) -m 'not full' $(PYTEST_ARGS)

# PYTEST_ARGS='-m full': only what `make test` leaves out.
test-full: $(TEST_READY)
	$(PYTEST) $(PYTEST_ARGS)

# With COVER=1, tests note which lines of the package they and the processes that they start run.
ifdef COVER
export COVERAGE_FILE = $(CURDIR)/.coverage
export COVERAGE_CORE = $(shell $(PYTHON) -c 'import sys; print("sysmon" if sys.version_info >= (3, 12) else "ctrace")')
endif

coverage: $(TEST_READY)
	rm -f .coverage .coverage.*
	$(MAKE) --no-print-directory test-full COVER=1
	$(MAKE) --no-print-directory coverage-report

coverage-report: $(TEST_READY)
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report

mutate: $(TEST_READY)
	$(BIN)/python test/mutation/mutate.py $(MUTATE_ARGS)

lint: $(TEST_READY)
	$(BIN)/python -m ruff check $(PYTHON_SOURCES)
	$(BIN)/python -m flake8 $(PYTHON_SOURCES)
	$(BIN)/python -m mypy
	$(BIN)/python -m mypy benchmark/*.py benchmark/targets/*.py

docs: $(TEST_READY)
	$(BIN)/python -m sphinx -q -W --keep-going docs build/docs

bench: $(READY)
	$(BIN)/python benchmark/bench.py $(BENCH_ARGS)

soak: $(TEST_READY)
	$(BIN)/python test/soak/soak.py $(SOAK_ARGS)

$(READY): setup.py
	@$(PYTHON) -c 'import sys; assert (3, 10) <= sys.version_info[:2] <= (3, 14), sys.version' \
		|| { echo 'make: set PYTHON to a Python from 3.10 to 3.14' >&2; exit 1; }
	@$(PYTHON) -m venv $(if $(wildcard $(ROS_NOT_FROM:%=$(VENV)/.ready-%)),--clear) $(VENV_ARGS) $(VENV)
	@$(PREPARE)
	$(call install,the package and what it runs with,$(RUN_PACKAGES))
	@[ '$(LOCKED)' != 1 ] \
		|| $(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m manip_sim.control.law.loading
	@touch $@

$(TEST_READY): $(READY)
	$(call install,the tools of tests and documentation,$(TEST_PACKAGES))
	@touch $@

# All extras, but not those of hundreds of megabytes that tests do without.
LOCKED_EXTRAS = docs env filters jazzy jazzy-test meshes mutate onnx records run test viewer xacro
# For all Pythons at once, users and tests with the same versions. Without the extras that packages
# ask for, pip before 23.3, which Python 3.10 brings, takes a version for missing.
COMPILE = $(BIN)/uv pip compile --quiet --universal --python-version 3.10 --generate-hashes \
	--no-strip-extras --no-annotate --custom-compile-command 'make requirements' \
	$(REQUIREMENTS_ARGS) setup.py

requirements: $(READY)
	$(BIN)/python -m pip install --quiet uv
	$(COMPILE) $(LOCKED_EXTRAS:%=--extra %) --output-file requirements/test.txt
	$(COMPILE) --extra jazzy --extra viewer --extra records --constraint requirements/test.txt \
		--output-file requirements/run.txt

release: $(TEST_READY)
	rm -rf dist
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	$(BIN)/python -m cyclonedx_py requirements requirements/run.txt \
		--output-reproducible --output-format JSON --output-file dist/manip_sim.cdx.json

clean:
	rm -rf $(VENV) build install log *.egg-info
