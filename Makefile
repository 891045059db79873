# Commands for development, and for the demo without ROS. On a full ROS 2 installation, use colcon instead (README.md).
PYTHON ?= python3
ARGS ?=

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet --quiet
# Build with the pinned setuptools of the environment; pip would download an unpinned version for an isolated build.
INSTALL := $(PIP) install --no-build-isolation --constraint constraints.txt
# The list contains folders, too, because the time of a folder changes when a file in it is deleted.
SOURCES := package.xml setup.py setup.cfg $(shell find diffbot diffbot_* launch config resource rviz urdf -name __pycache__ -prune -o -print)

# A shell that has sourced a ROS installation or another environment sets these; its libraries must not mix with ours.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Let pytest cache the compiled test files: compiling them takes five seconds in each worker.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup programs demo test test-fast slow real lint bench trust docs site clean
.DELETE_ON_ERROR:

help:
	@echo "make setup      create $(VENV) with the package, ROS 2 Jazzy from wheels and all tools"
	@echo "make demo       drive a simulated robot to a goal pose, record a bag, write the report"
	@echo "make test       run the tests"
	@echo "make test-fast  run the tests without nodes, studies and installations, for use while editing"
	@echo "make slow       run the slow tests: repeated faults, ten minutes of goals, many dockings"
	@echo "make lint       run ruff, mypy, import-linter and oxlint"
	@echo "make bench      compare latency, recorder and compiled loop with references"
	@echo "make trust      run the tests of a fresh clone 20 times, every second time on a busy machine"
	@echo "make docs       update the generated parts of docs/"
	@echo "make site       build the documentation as a site: out/site/index.html"
	@echo "make clean      remove $(VENV) and everything built"
	@echo "ARGS='...' passes arguments to the command, PYTHON=... selects the interpreter (3.10 to 3.13)."

setup: $(VENV)/package.stamp
	@[ "$(MAKECMDGOALS)" != setup ] || echo "Next: source $(BIN)/activate; then diffbot demo, diffbot robot new my_robot.yaml, or diffbot for all commands"

demo: setup
	@$(BIN)/diffbot demo --overwrite $(ARGS)

# End a test that pytest's own timeout cannot end, because compiled code hangs and holds the GIL.
BOUNDED := -o faulthandler_timeout=950 -o faulthandler_exit_on_timeout=true

# Not `python -m pytest`, which would put the source tree before the installed package.
test: setup programs
	@$(BIN)/pytest -n 4 --dist loadfile --no-loadscope-reorder $(BOUNDED) $(ARGS)

# Programs that pip does not install: a compiler for the tests of Nav2's actions, and a browser for the tests of the page.
# Without a browser, pytest skips the tests of the page and reports them as skipped.
APT := export DEBIAN_FRONTEND=noninteractive; apt-get -qq -o Acquire::Retries=1 -o Acquire::http::Timeout=20 -o Acquire::https::Timeout=20
programs:
	@{ command -v gcc && command -v g++; } >/dev/null || if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		echo "Installing gcc and g++ ..."; $(APT) update && $(APT) install -y gcc g++ >/dev/null; \
	else \
		echo "The tests need gcc and g++: sudo apt-get install gcc g++" >&2; exit 1; \
	fi
	@{ command -v chromium || command -v chromium-browser || command -v google-chrome; } >/dev/null || if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
		echo "Installing chromium ..."; $(APT) update && $(APT) install -y --no-install-recommends chromium >/dev/null || true; \
	else \
		echo "Without a browser, the tests of the page are skipped: sudo apt-get install chromium" >&2; \
	fi

test-fast: setup
	@$(BIN)/pytest -n 3 --dist loadfile -m 'not graph and not install and not study and not slow' $(ARGS)

# One test at a time, since many of them measure times. Do not use the machine for other work meanwhile.
slow: setup programs
	@$(BIN)/pytest -m slow $(ARGS)

# Run the tests of nodes in the environment of `make setup` with an overlay of ROS packages: docs/how-to/install-on-ros.md.
real: setup
	@test -n "$(OVERLAY)" || { echo "make real OVERLAY=<folder of installed ROS packages>: docs/how-to/install-on-ros.md" >&2; exit 1; }
	@test/real/overlay.sh $(VENV) $(OVERLAY) pytest -n 2 --dist loadfile -m 'graph and not install and not slow' $(BOUNDED) $(ARGS)

lint: setup
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-cache
	@$(BIN)/oxlint --quiet diffbot_tools/view/page

bench: setup
	@for name in latency recorder batch; do echo "== $$name"; $(BIN)/python bench/$$name.py $(ARGS) || exit 1; done

trust:
	@bench/trust.sh $(ARGS)

docs: setup
	@$(BIN)/python docs/build.py $(ARGS)

# With --strict, a page outside the navigation, a broken link or a missing anchor is an error. --quiet would hide these.
site: setup
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "Site out/site/index.html (open it in a browser)"

clean:
	@rm -rf $(VENV) build install log out *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	@find . -name __pycache__ -prune -exec rm -rf {} +

# This rule also runs if the interpreter of the environment was removed, because then the link is broken.
$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) was not found: install Python 3.10 to 3.13 or set PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; (3, 10) <= v <= (3, 13) or sys.exit(f"Python 3.10 to 3.13 is needed, but $(PYTHON) is {v[0]}.{v[1]}: set PYTHON=...")'
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
	    package=$$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'); \
	    if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	        echo "Installing $$package ..."; \
	        apt-get -qq update && DEBIAN_FRONTEND=noninteractive apt-get -qq install -y $$package >/dev/null; \
	    else \
	        echo "This Python cannot create virtual environments: install $$package (sudo apt-get install $$package)" >&2; exit 1; \
	    fi; }
	@$(PYTHON) -m venv --clear $(VENV)

# The stamp is touched before the step and renamed after it. So make repeats a step that was interrupted, and a step whose
# sources changed while it ran.
$(VENV)/dependencies.stamp: setup.py constraints.txt | $(BIN)/python
	@echo "Installing the dependencies into $(VENV), which takes a minute or two ..."
	@touch $@.begun
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip >/dev/null
	@$(PIP) install --constraint constraints.txt pip setuptools
	@rm -rf build/lib *.egg-info
	@$(INSTALL) '.[jazzy,test,lint,docs,batch,cluster,gym]'
	@mv $@.begun $@

# build/lib may contain modules that have been deleted from the sources, so delete it first.
$(VENV)/package.stamp: $(VENV)/dependencies.stamp $(SOURCES)
	@echo "Installing diffbot into $(VENV) ..."
	@touch $@.begun
	@rm -rf build/lib *.egg-info
	@$(PIP) uninstall --yes diffbot # former name of the distribution
	@$(INSTALL) --no-deps --force-reinstall .
	@rm -rf build/lib build/bdist.* *.egg-info; rmdir build 2>/dev/null || true
	@mv $@.begun $@
