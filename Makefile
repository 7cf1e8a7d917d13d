# make demo        the main job on the sample videos        make test   lint and tests, minutes   make docs   build/site/index.html
# make test-all    lint and every test, an hour: statistics over many seeds, whole campaigns and diagnoses, too
# make wheel       dist/ with wheel and sdist               make sbom   dist/ with what the wheel brings along (CycloneDX)
# make lock        release/*.txt anew, from constraints.txt
# make version VERSION=0.3.0   the new version in all files that say it (docs/developer/release.md)
# make wheel-test  the tests against an installed wheel (TESTS='-k lens' passes options on)
# KORNIA=0         tests without torch and kornia           PYTHON=...  another interpreter (3.11 or newer)
# WORKERS=auto     processes of the tests, one a core
PYTHON ?= python3
KORNIA ?= 1
WORKERS ?= auto
VENV := .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml Makefile $(wildcard release/*.txt)

# The main job needs neither torch nor kornia; the tests do, to check the derivatives behind the uncertainties.
TORCH := $(shell sed -n 's/.*"\(torch==[0-9.]*\)".*/\1/p' pyproject.toml)
VERSION_NOW := $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
TORCH_CPU := https://download.pytorch.org/whl/cpu

ifeq ($(KORNIA),0)
EXTRAS := test
STAMP := plain
FILES := -r release/run.txt -r release/test.txt
else
EXTRAS := test,kornia
STAMP := kornia
FILES := -r release/run.txt -r release/test.txt -r release/kornia.txt
endif
HASHED := -m pip install --quiet --no-deps --require-hashes
THIS := -m pip install --quiet --no-deps --no-build-isolation -e .

# Without a GPU the CPU build, of a tenth of the size, goes in first and the pin accepts it. $(1): the environment's folder
NO_TORCH = ! $(1)/bin/python -c 'import importlib.util as u, sys; sys.exit(u.find_spec("torch") is None)'
define cpu_torch
@if [ '$(KORNIA)' != 0 ] && ! command -v nvidia-smi >/dev/null && $(NO_TORCH); then \
  $(1)/bin/python -m pip install --quiet --no-deps '$(TORCH)' --retries 1 --index-url $(TORCH_CPU) \
  || echo "$(TORCH_CPU) cannot be reached: the default build of torch follows, several GB (KORNIA=0 leaves it out)" >&2; fi
endef

.PHONY: demo test test-all pytest lint wheel wheel-test sbom lock version clean docs

demo: $(VENV)/.demo
	$(BIN)/towline run sample_videos/leander_steady/hole6 sample_videos/leander_steady/hole5 sample_videos/leander_steady/hole4 sample_videos/leander_steady/hole3
	$(BIN)/towline run sample_videos/mariner/x1446 sample_videos/mariner/x1548 sample_videos/mariner/x1649 sample_videos/mariner/x1751

# Types are checked by one core while the tests run on the others; either one fails the whole.
test: $(VENV)/.test-$(STAMP)
	@$(MAKE) --no-print-directory -j2 lint pytest TESTS='-m "not slow" $(TESTS)'

test-all: $(VENV)/.test-$(STAMP)
	@$(MAKE) --no-print-directory -j2 lint pytest

# Byte code is kept, whatever the environment says: a hundred tests start Python anew, and each would compile the package first.
pytest: $(VENV)/.test-$(STAMP)
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests -n $(WORKERS) --dist worksteal $(TESTS)

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
	$(BIN)/python $(HASHED) -r release/run.txt
	$(BIN)/python $(THIS)
	@touch $@

$(VENV)/.test-$(STAMP): $(BIN)/python $(SOURCES)
	$(call cpu_torch,$(VENV))
	$(BIN)/python $(HASHED) $(FILES)
	@if [ '$(KORNIA)' != 0 ] && $(call NO_TORCH,$(VENV)); then $(BIN)/python $(HASHED) -r release/torch.txt; fi
	$(BIN)/python $(THIS)
	@touch $@

# Of the same commit the same bytes: files have the commit's time.
wheel: build/release/.tools
	SOURCE_DATE_EPOCH="$$(git log -1 --format=%ct 2>/dev/null || echo 0)" \
	  build/release/venv/bin/python -m build --no-isolation --outdir dist .

# What is in an environment of the wheel and nothing else, with versions and licences.
sbom: wheel
	@rm -rf build/sbom && mkdir -p build/sbom
	@$(MAKE) --no-print-directory VENV=build/sbom/venv build/sbom/venv/bin/python
	build/sbom/venv/bin/python $(HASHED) -r release/run.txt
	build/sbom/venv/bin/python -m pip install --quiet --no-deps dist/towline-$(VERSION_NOW)-py3-none-any.whl
	build/sbom/venv/bin/python -m pip uninstall --quiet --yes setuptools pip
	build/release/venv/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible \
	  --output-file dist/towline-$(VERSION_NOW).cdx.json build/sbom/venv/bin/python

build/release/.tools: $(SOURCES)
	@mkdir -p build/release
	@$(MAKE) --no-print-directory VENV=build/release/venv build/release/venv/bin/python
	build/release/venv/bin/python $(HASHED) -r release/release.txt
	@touch $@

lock: $(BIN)/python
	$(BIN)/python -m pip install --quiet 'uv>=0.5'
	$(BIN)/python release/lock.py

version: $(BIN)/python
	$(BIN)/python release/version.py '$(VERSION)'

clean:
	rm -rf $(VENV) build dist *.egg-info
