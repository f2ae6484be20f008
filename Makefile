# Two commands matter: `make demo` (see it work) and `make test` (prove it works).
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
# --no-compile: Python compiles what is imported; compiling all of torch's files takes longer than everything else
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
ENGINE := src/mulan/radiance/native
ENGINE_SOURCES := $(ENGINE)/CMakeLists.txt $(wildcard $(ENGINE)/src/* $(ENGINE)/include/*)
ENGINE_LOADS := $(BIN)/python -c 'import sys; from mulan.radiance.kernels.native_library import find_native_library as f; sys.exit(f()[0] is None)'

.DEFAULT_GOAL := help
.PHONY: help install demo test lint browser sanitize clean

help:
	@echo "make demo   install into $(VENV), reconstruct a room with three simulated robots, print where the report is"
	@echo "make test   everything continuous integration checks: format, lint, types, import rule, tests"
	@echo "make sanitize  build the engine with ASan+UBSan and with TSan; fuzzing and its tests under each (minutes)"
	@echo "make clean  remove $(VENV) and build leftovers (never runs/)"

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "MULAN needs Python 3.11 or newer; '$(PYTHON)' is older. Try: make PYTHON=python3.12 demo"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
	  { echo "Python cannot make virtual environments; on Debian: apt-get install python3-venv"; rm -rf $(VENV); exit 1; }
	@touch $@

# Without a compiler the install is whole all the same (torch runs); with one, a failed build is tried once more, aloud.
$(VENV)/.installed: $(VENV)/.python pyproject.toml constraints.txt $(ENGINE_SOURCES)
	@echo "Installing MULAN into $(VENV) (about a minute) ..."
	@$(PIP) -e .
	@if ! $(ENGINE_LOADS) && command -v c++ >/dev/null 2>&1; then \
	  echo "The C++ engine was not built though there is a compiler; once more, one file at a time:"; \
	  CMAKE_BUILD_PARALLEL_LEVEL=1 $(PIP) --verbose --no-deps -e . 2>&1 | tail -n 40; \
	  $(ENGINE_LOADS) || echo "Still no C++ engine: MULAN runs on torch, several times slower."; \
	fi
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed pyproject.toml constraints.txt
	@echo "Installing the development tools ..."
	@$(PIP) -e '.[dev]'
	@touch $@

install: $(VENV)/.installed

demo: $(VENV)/.installed
	@$(BIN)/mulan demo --out runs/demo

lint: $(VENV)/.installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports --no-cache
	$(BIN)/pyright --pythonpath $(BIN)/python

# The report is looked at in a real browser. Root on Debian: installed here; otherwise those tests say they were skipped.
browser:
	@command -v chromium chromium-browser google-chrome >/dev/null 2>&1 || \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then \
	    echo "Installing chromium for the browser tests ..."; \
	    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium; } >/dev/null; \
	  else \
	    echo "No Chromium: the browser tests will be skipped. On Debian: sudo apt-get install chromium"; \
	  fi

test: lint browser
	$(BIN)/pytest -n 2 --dist loadfile

sanitize: $(VENV)/.installed-dev
	@$(BIN)/python -m tests.native.sanitizers

clean:
	rm -rf $(VENV) build dist src/*.egg-info .pytest_cache .ruff_cache
