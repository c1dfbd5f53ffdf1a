PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TOOLS := $(VENV)/.tools-installed
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
KERNELS := out/.kernels

.PHONY: demo test test-all check docs commands pictures wheel-check lock clean setup

setup: $(STAMP)

$(STAMP): pyproject.toml requirements.lock tools/system_libraries.sh
	bash tools/system_libraries.sh
	$(PYTHON) -c 'import sys; sys.exit("planview needs Python 3.11 or newer, found " + sys.version.split()[0]) if sys.version_info < (3, 11) else None'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes -r requirements.lock
	$(PIP) --no-deps -e . --config-settings editable_mode=compat  # which mypy and pyright see
	touch $(STAMP)

# What tests, checks and documentation need on top of what users need.
$(TOOLS): $(STAMP) requirements-dev.lock
	$(PIP) --require-hashes -r requirements-dev.lock
	touch $(TOOLS)

demo: setup
	$(BIN)/planview demo

# Compiled once, before the tests' two workers start, and kept next to the sources.
$(KERNELS): $(TOOLS) $(shell find calib stereo planview -name '*.py')
	$(BIN)/python tests/compile_kernels.py
	mkdir -p out && touch $@

test: $(KERNELS)
	$(BIN)/python -m pytest -n 2 -m "not slow"

test-all: test
	HYPOTHESIS_PROFILE=thorough $(BIN)/python -m pytest -n 2 -m "slow or fuzz"

check: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/reference.py --check
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

docs: $(TOOLS)
	$(BIN)/python tools/reference.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "open out/site/index.html, or: $(BIN)/mkdocs serve"

# Every picture of README.md and docs/; DATA=FOLDER has the recordings that are not in the repository.
pictures: $(KERNELS)
	$(BIN)/python tools/pictures.py $(if $(DATA),--data $(DATA))

# Every command of the documents that needs only the demo clip; out/commands.md has what they print.
commands: $(KERNELS)
	$(BIN)/python tools/typed.py

wheel-check: $(TOOLS)
	bash tools/wheel_check.sh $(BIN)/python

lock:
	uv lock --quiet
	uv export --frozen --quiet --extra ui --extra ros --extra table --no-emit-project --no-header -o requirements.lock
	uv export --frozen --quiet --all-extras --no-emit-project --no-header -o requirements-dev.lock
	rm -f uv.lock

clean:
	rm -rf $(VENV) out build *.egg-info
