# `make demo` records a labeled run, `make test` runs all tests; each sets up what it needs.
# The environment is .venv in this checkout, so the command is .venv/bin/vrcaps.

VENV := .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml constraints.txt rust/Cargo.toml rust/Cargo.lock $(shell find rust/src -name '*.rs')
RUST_VERSION = $(shell sed -n 's/^rust-version = "\(.*\)"/\1/p' rust/Cargo.toml)
PYTHON = $(shell for python in python3.11 python3.12 python3.13 python3.14 python3; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& command -v $$python && break; done)
INSTALL = VIRTUAL_ENV=$(CURDIR)/$(VENV) $(BIN)/uv pip install --quiet --constraint constraints.txt \
	--no-build-isolation

export PATH := $(CURDIR)/$(BIN):$(PATH):$(HOME)/.cargo/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Rust tests call no Python, so they need no libpython to link; these settings are maturin's own.
export PYO3_PYTHON := $(CURDIR)/$(BIN)/python
export PYO3_BUILD_EXTENSION_MODULE := 1

.PHONY: help demo test test-python test-rust test-fast test-servers validate check check-python check-rust \
	 docs notebooks figures wheel constraints clean
.DELETE_ON_ERROR:

help:
	@echo "make demo   record a labeled run through a generated colon into runs/demo"
	@echo "make test   run all tests"
	@echo "make test-fast  run the tests that are not marked slow, in under a minute"
	@echo "make test-servers  run the tests that start a Ray cluster or an S3 server, in two minutes"
	@echo "make validate  run the tests of claims at their full size, in a few minutes"
	@echo "make check  lint, format and type checks"
	@echo "make docs   build the documentation site into site"
	@echo "make notebooks  run the tutorials at their full length, in half an hour"
	@echo "make figures  measure the tables of docs/results again;"
	@echo "            resumes after an interruption; ONLY='path radiosity' measures those by part of the name"
	@echo "make wheel  build a wheel into dist and try it in a clean environment"
	@echo "make constraints  pin the newest versions of all dependencies in constraints.txt"
	@echo "make clean  remove the environment and everything built"

demo: $(VENV)/.stamp-run
	$(BIN)/vrcaps demo

test: test-python test-rust

test-python: $(VENV)/.stamp-dev
	$(BIN)/python -m pytest -n 2 --dist worksteal $(PYTEST)

# Without --lib the core is built twice, once for programs in comments, of which there are none.
test-rust: $(VENV)/.stamp-venv
	cargo test --quiet --lib --manifest-path rust/Cargo.toml

test-fast: $(VENV)/.stamp-dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m 'not slow and not wheel and not server and not notebook and not validation'

validate: $(VENV)/.stamp-dev
	$(BIN)/python -m pytest -n 2 --dist worksteal -m validation

notebooks: $(VENV)/.stamp-dev
	$(BIN)/python -m pytest -m notebook tests/docs

test-servers: $(VENV)/.stamp-dev
	$(BIN)/python -m pytest -m server

check: check-python check-rust

check-python: $(VENV)/.stamp-packages
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

check-rust: $(VENV)/.stamp-venv
	cargo fmt --manifest-path rust/Cargo.toml --check
	cargo clippy --quiet --manifest-path rust/Cargo.toml --all-targets -- -D warnings

docs: $(VENV)/.stamp-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "Open site/index.html"

figures: $(VENV)/.stamp-dev
	$(BIN)/python -m benchmarks.figures $(if $(ONLY),--only $(ONLY))

wheel: $(VENV)/.stamp-dev
	rm -f dist/*.whl
	$(BIN)/maturin build --quiet --release --out dist
	$(BIN)/python -m pytest tests/test_packaging.py -m wheel

constraints: $(VENV)/.stamp-dev
	$(BIN)/python -m pip install --quiet --upgrade --upgrade-strategy eager --editable '.[dev,docs]' uv
	head -1 constraints.txt > constraints.new
	$(BIN)/python -m pip freeze --exclude-editable >> constraints.new
	mv constraints.new constraints.txt

clean:
	rm -rf $(VENV) dist site rust/target src/vrcaps/_core*.so

$(VENV)/.stamp-venv:
	$(if $(PYTHON),,$(error Python 3.11 or newer is needed and was not found. On Debian: apt install python3.11 python3.11-venv))
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
		echo "$(PYTHON) has no venv module. On Debian: apt install $(notdir $(PYTHON))-venv" >&2; exit 1; }
	@command -v cc >/dev/null || { \
		echo "A C linker (cc) is needed and was not found. On Debian: apt install gcc" >&2; exit 1; }
	@command -v cargo >/dev/null || { \
		echo "cargo $(RUST_VERSION) or newer is needed and was not found. Install Rust with rustup" >&2; exit 1; }
	@found=$$(cargo --version | cut -d' ' -f2); \
	printf '%s\n' $(RUST_VERSION) $$found | sort --version-sort --check=quiet || { \
		echo "cargo $(RUST_VERSION) or newer is needed, found $$found. Install Rust with rustup" >&2; exit 1; }
	@echo "Setting up $(VENV) with $(PYTHON) (once, a few minutes)"
	@$(PYTHON) -m venv --clear $(VENV)
	@$(BIN)/python -m pip install --quiet --constraint constraints.txt 'maturin>=1.9,<2' 'uv>=0.5'
	@touch $@

$(VENV)/.stamp-run: $(VENV)/.stamp-venv $(SOURCES)
	@echo "Building and installing vrcaps"
	@$(INSTALL) --editable '.[organs,reports,video]'
	@touch $@

$(VENV)/.stamp-packages: $(VENV)/.stamp-venv pyproject.toml constraints.txt
	@echo "Installing development tools"
	@$(INSTALL) --requirements pyproject.toml --extra dev
	@touch $@

$(VENV)/.stamp-dev: $(VENV)/.stamp-packages $(SOURCES)
	@echo "Building and installing vrcaps with its development tools"
	@$(INSTALL) --editable '.[dev]'
	@touch $(VENV)/.stamp-run $@

$(VENV)/.stamp-docs: $(VENV)/.stamp-venv $(SOURCES)
	@echo "Building and installing vrcaps with what its documentation needs"
	@$(INSTALL) --editable '.[docs]'
	@touch $(VENV)/.stamp-run $@
