# Everything runs in the project's own .venv, installed from requirements.lock; VENV names another folder for it.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
INSTALLED := $(VENV)/.installed
LOCKED_ONLY := --no-deps --only-binary :all: --require-hashes

.DEFAULT_GOAL := help
KERNELS := src/adaptrack/core/built/manifest.json
.PHONY: help install install-extras run test test-slow test-slow-part test-interpreted coverage lint format docs wheel try-wheel bench lock clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1|/' | column -t -s '|'

install: $(INSTALLED) $(KERNELS) ## create .venv, install the locked packages and adaptrack into it, and compile the kernels

$(KERNELS): requirements.lock pyproject.toml src/adaptrack/__init__.py $(shell find src/adaptrack/core -name '*.py' -o -path '*/build/*.[ch]') | $(INSTALLED)
	@$(BIN)/python -m adaptrack.core.build

$(INSTALLED): requirements.lock pyproject.toml src/adaptrack/__init__.py
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "adaptrack needs Python 3.11 or newer, and this is %s: try make PYTHON=python3.12 ..." % sys.version.split()[0])'
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV) || { \
	  echo 'No ensurepip here: taking pip itself from the package index.'; \
	  $(PYTHON) -m venv --clear --without-pip $(VENV) && $(PYTHON) -m pip --python $(VENV) install --quiet pip; }
	@mkdir -p build && sed -n '/^uv==/,/[^\\]$$/p' requirements.lock > build/uv.txt
	$(PIP) install --no-deps --only-binary :all: --require-hashes -r build/uv.txt
	@$(BIN)/uv pip install --quiet --python $(BIN)/python $(LOCKED_ONLY) -r requirements.lock || { \
	  echo 'uv does not reach the package index: pip, which may be set up otherwise, installs the packages.'; \
	  $(PIP) install $(LOCKED_ONLY) -r requirements.lock; }
	$(PIP) install --no-deps --no-build-isolation --editable .
	@$(PIP) check
	@touch $@

run: install ## run the paper's experiment again: results/index.html
	$(BIN)/adaptrack paper reproduce --out results

# The bytecode of tests and package is kept, whatever the environment says: to make it takes 12 s of each process.
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -q -n 2 --dist worksteal

test: install ## run the tests
	$(PYTEST)

test-slow: install ## run all tests, those that take minutes too
	$(PYTEST) -m 'slow or not slow'

SLOW_PART ?= $(shell git rev-list --count HEAD 2>/dev/null || date +%s)
test-slow-part: install ## run a fifth of the slow tests, another one with each commit; SLOW_PART=N chooses
	@echo 'SLOW_PART=$(SLOW_PART)'
	SLOW_PART=$(SLOW_PART) $(PYTEST) -m slow

test-interpreted: install ## run the tests of kernels with the compiler switched off
	ADAPTRACK_KERNELS=interpreted $(PYTEST) -m 'kernels and not slow and not compiled'

coverage: install ## run the tests and count which lines of Python they reach: results/coverage/index.html
	$(PYTEST) --cov=adaptrack --cov-branch --cov-report=term:skip-covered --cov-report=html:results/coverage

lint: install ## check style, types and the imports between the rooms
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install ## rewrite the sources in the project's style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: install ## build the documentation: docs/_build/html/index.html
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -b html docs docs/_build/html

wheel: install ## build a wheel with kernels for every processor of this kind: dist/adaptrack-*.whl
	rm -rf dist
	$(BIN)/python -m hatchling build --target wheel

TRIED := build/try
try-wheel: ## drive with the wheel in dist/ in an environment of its own, which PYTHON chooses; no compiler, no checkout
	test -n "$(wildcard dist/adaptrack-*.whl)" || { echo 'No wheel in dist/: make wheel'; exit 1; }
	rm -rf $(TRIED) && $(BIN)/uv venv --quiet --python "$$(command -v $(PYTHON))" $(TRIED)
	@$(BIN)/uv pip install --quiet --python $(TRIED)/bin/python dist/adaptrack-*.whl
	cd $(TRIED) && bin/adaptrack --version && bin/adaptrack drive triple-lane-change --out page
	cd $(TRIED) && bin/adaptrack drive town --vehicle midsize-sedan

bench: install ## time one control step and the compiled batch of runs
	$(BIN)/python -m tools.bench step --json
	$(BIN)/python -m tools.bench rollout --json

install-extras: install requirements-extras.lock ## install also what others bring: CommonRoad's roads and cars, Gymnasium
	$(PIP) install --no-deps --only-binary :all: --require-hashes -r requirements-extras.lock

COMPILE := $(BIN)/uv pip compile pyproject.toml --universal --fork-strategy fewest --generate-hashes --upgrade \
	  --no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' --quiet
LOCKED := --extra compile --extra cluster --extra docs --extra dev

lock: ## renew requirements.lock and requirements-extras.lock from pyproject.toml
	$(COMPILE) $(LOCKED) --output-file requirements.lock
	$(COMPILE) --extra bench --extra commonroad --extra fmu --extra gym --constraints requirements.lock --output-file requirements-extras.lock

clean: ## remove everything that can be made again
	rm -rf .venv* build dist results docs/_build src/adaptrack/core/built .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
