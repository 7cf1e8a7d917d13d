# make demo        the main job on the sample videos        make test   lint and tests        make docs   build/site/index.html
# make wheel       dist/ with wheel and sdist
# make wheel-test  the tests against an installed wheel (TESTS='-k lens' passes options on)
# KORNIA=0         tests without torch and kornia           PYTHON=...  another interpreter (3.11 or newer)
# WORKERS=auto     processes of the tests, one a core
PYTHON ?= python3
KORNIA ?= 1
WORKERS ?= auto
VENV := .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml Makefile

# The main job needs neither torch nor kornia; the tests do, to check the derivatives behind the uncertainties.
TORCH := $(shell sed -n 's/.*"\(torch==[0-9.]*\)".*/\1/p' pyproject.toml)
TORCH_CPU := https://download.pytorch.org/whl/cpu

ifeq ($(KORNIA),0)
EXTRAS := test
STAMP := plain
else
EXTRAS := test,kornia
STAMP := kornia
endif

# Without a GPU the CPU build, of a tenth of the size, goes in first and the pin accepts it. $(1): the environment's folder
define cpu_torch
@if [ '$(KORNIA)' != 0 ] && ! command -v nvidia-smi >/dev/null && ! $(1)/bin/python -c 'import torch' 2>/dev/null; then \
  $(1)/bin/python -m pip install --quiet '$(TORCH)' --retries 1 --index-url $(TORCH_CPU) \
  || echo "$(TORCH_CPU) cannot be reached: the default build of torch follows, several GB (KORNIA=0 leaves it out)" >&2; fi
endef

.PHONY: demo test pytest lint wheel wheel-test clean docs

demo: $(VENV)/.demo
	$(BIN)/towline run sample_videos/leander_steady/hole6 sample_videos/leander_steady/hole5 sample_videos/leander_steady/hole4 sample_videos/leander_steady/hole3
	$(BIN)/towline run sample_videos/mariner/x1446 sample_videos/mariner/x1548 sample_videos/mariner/x1649 sample_videos/mariner/x1751

# Types are checked by one core while the tests run on the others; either one fails the whole.
test: $(VENV)/.test-$(STAMP)
	@$(MAKE) --no-print-directory -j2 lint pytest

pytest: $(VENV)/.test-$(STAMP)
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests -n $(WORKERS) --dist worksteal

lint: $(VENV)/.test-$(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@mkdir -p $(VENV)/typed && ln -sfn ../.. $(VENV)/typed/towline
	$(BIN)/basedpyright --project $(VENV)/typed/towline/tests/pyrightconfig.json --pythonpath $(BIN)/python

docs: $(VENV)/.test-$(STAMP)
	$(BIN)/python -m towline.record.reference > docs/formats/reference.md
	$(BIN)/python -m towline.diagnose.effects.page > docs/effects.md
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@echo "build/site/index.html"

# A virtual environment with only python3 and pip: the standard venv where its ensurepip is there, else virtualenv from pip.
$(BIN)/python:
	@if $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then :; else echo "towline needs Python 3.11 or newer; $(PYTHON) is older (make PYTHON=python3.12 ...)" >&2; exit 1; fi
	@$(PYTHON) -m venv $(VENV) 2>/dev/null || { rm -rf $(VENV); \
	  $(PYTHON) -m pip install --quiet --target .virtualenv-bootstrap virtualenv && \
	  PYTHONPATH=.virtualenv-bootstrap $(PYTHON) -m virtualenv --quiet $(VENV) && rm -rf .virtualenv-bootstrap; }

# The wheel in an environment of its own, with the versions of constraints.txt, and the tests against what it installed.
wheel-test:
	@rm -rf build/wheel-test && mkdir -p build/wheel-test
	@$(MAKE) --no-print-directory VENV=build/wheel-test/venv build/wheel-test/venv/bin/python
	$(call cpu_torch,build/wheel-test/venv)
	build/wheel-test/venv/bin/python -m pip wheel --quiet --no-deps -w build/wheel-test .
	build/wheel-test/venv/bin/python -m pip install --quiet -c constraints.txt "$$(ls build/wheel-test/towline-*.whl)[$(EXTRAS)]"
	@cd build/wheel-test && venv/bin/python -c 'import sys, towline; sys.exit(None if "site-packages" in towline.__file__ else towline.__file__)'
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 build/wheel-test/venv/bin/python -m pytest tests $(TESTS)

$(VENV)/.demo: $(BIN)/python $(SOURCES)
	$(BIN)/python -m pip install --quiet -e .
	@touch $@

$(VENV)/.test-$(STAMP): $(BIN)/python $(SOURCES)
	$(call cpu_torch,$(VENV))
	$(BIN)/python -m pip install --quiet -e '.[$(EXTRAS)]'
	@touch $@

wheel: $(VENV)/.demo
	$(BIN)/python -m pip install --quiet build
	$(BIN)/python -m build --outdir dist .

clean:
	rm -rf $(VENV) build dist *.egg-info
