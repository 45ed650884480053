# Needs make, Python 3.11 and pip, nothing else; everything is installed below .venv.

SHELL       := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
MAKEFLAGS   += --no-builtin-rules
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

PYTHON   ?= python3.11
VENV     := .venv
BIN      := $(VENV)/bin
STAMP    := $(VENV)/installed
LOCK     := requirements.lock
LOCK_BOX := .lock-venv
IMAGES   := follower sim
TYPED    := wire agents sim_server deploy tests benchmarks docs/docsite
SIDE_BY_SIDE := -n logical --maxprocesses 4 --dist loadfile --no-loadscope-reorder
PIP_INSTALL := -m pip --disable-pip-version-check --no-input install --progress-bar off --quiet

# A sourced ROS workspace puts its own numpy, pinocchio and pytest plug-ins here; .venv shall hold what the lock says.
unexport PYTHONPATH PYTHONHOME

.PHONY: help
help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-15s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

.PHONY: install
install: $(STAMP) ## set up .venv from requirements.lock (PYTHON=... chooses the interpreter)

.PHONY: python
python:
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "Palanquin needs Python 3.11 or newer, and '$(PYTHON)' is not one: install it, or name it with 'make install PYTHON=/path/to/python3.11'." >&2; \
	  exit 1; }

$(STAMP): pyproject.toml $(LOCK) | python
	@echo "== install: $(VENV) (about 1.5 GB, a minute or two the first time)"
	@rm -f $@
	@"$(PYTHON)" -m venv $(VENV)
	@$(BIN)/python $(PIP_INSTALL) --require-hashes -r $(LOCK)
	@$(BIN)/python $(PIP_INSTALL) --no-deps --no-build-isolation -e .
	@touch $@

.PHONY: demo
demo: install ## a team of arms carries a load: palanquin run transport
	@$(BIN)/palanquin run transport

.PHONY: docs
docs: install ## build the documentation site into build/docs/site; a broken link is an error
	@PYTHONPATH=docs $(BIN)/python -m docsite --into build/docs

.PHONY: lint
lint: install ## ruff check, ruff format --check, mypy
	@echo "== ruff check"
	@$(BIN)/ruff check .
	@echo "== ruff format --check"
	@$(BIN)/ruff format --check .
	@echo "== mypy"
	@$(BIN)/mypy $(TYPED)

.PHONY: test
test: lint ## lint, then all tests (PYTEST_ARGS=... is passed on)
	@echo "== pytest"
	@$(BIN)/python -m pytest $(SIDE_BY_SIDE) $(PYTEST_ARGS)

# BASE=... for another base image, such as one that was made without the internet (docs/containers.md).
.PHONY: images
images: ## build the images palanquin-follower and palanquin-sim (needs Docker; BASE=... chooses the base)
	@for role in $(IMAGES); do \
	  echo "== image palanquin-$$role"; \
	  docker build --quiet $(if $(BASE),--build-arg BASE=$(BASE)) -f deploy/Dockerfile --target $$role -t palanquin-$$role .; \
	done

.PHONY: test-containers
test-containers: install images ## build the images, then test a carry in containers (needs Docker and Compose)
	@echo "== pytest -m containers"
	@$(BIN)/python -m pytest -m containers $(PYTEST_ARGS)

# A minute or two and 1.5 GB, and it asks the package index: so it is no part of `make test`.
.PHONY: wheel-check
wheel-check: install ## build the wheel, install it into a new environment, and run a scenario there, outside the checkout
	@$(BIN)/python tests/wheel_check.py

# Keeps the versions already locked unless pyproject.toml asks otherwise; UPGRADE=--upgrade takes the newest.
# An image installs one role of it, from a lock of its own: the same versions, without the rest.
COMPILE := $(LOCK_BOX)/bin/uv pip compile pyproject.toml --universal --python-version 3.11 --fork-strategy fewest \
  --generate-hashes --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" --quiet
.PHONY: lock
lock: python ## rebuild requirements.lock (UPGRADE=--upgrade takes the newest versions)
	@test -x $(LOCK_BOX)/bin/uv || { "$(PYTHON)" -m venv $(LOCK_BOX) && $(LOCK_BOX)/bin/python $(PIP_INSTALL) uv; }
	@$(COMPILE) --extra all --group dev $(UPGRADE) --output-file $(LOCK)
	@for role in $(IMAGES); do \
	  rm -f deploy/requirements-$$role.lock; \
	  $(COMPILE) --extra $$role --group build --constraint $(LOCK) --output-file deploy/requirements-$$role.lock; \
	done

.PHONY: clean
clean: ## remove .venv, caches and build products (runs/ stays)
	rm -rf $(VENV) $(LOCK_BOX) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
