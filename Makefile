# Everything runs in .venv, which `setup` makes from the lock files; `demo` needs no extra.
# The newest Python that runs and can make it, on the PATH or of pyenv, whose shims fail where no
# version is set; another one: make PYTHON=python3.11 (with a VENV of its own).
VENV ?= .venv
PYTHON ?= $(shell for v in 13 12 11; do \
	for p in python3.$$v $${PYENV_ROOT:-$$HOME/.pyenv}/versions/3.$$v.*/bin/python; do \
	$$p scripts/check_python.py 2>/dev/null && echo $$p && exit; done; done; echo python3)
BIN := $(VENV)/bin
BASE := $(VENV)/.base
READY := $(VENV)/.ready
PIP := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check
# Runs a long command, and says every 20 s that it does.
define patiently
@(s=0; while sleep 20 >/dev/null 2>&1; do s=$$((s + 20)); \
	echo "  $$s s: $$(du -sm $(VENV) | cut -f1) MB are in $(VENV)"; done) & \
	beat=$$!; trap "kill $$beat" EXIT; $(1)
endef
# A test process is one core's work: libraries that start threads in each slow one another down.
# A file's tests stay in one process, so that what they share is collected or trained once.
# Tests start many processes, which shall not compile the package each.
PYTEST := OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest \
	-n $(shell getconf _NPROCESSORS_ONLN) --dist loadfile --no-loadscope-reorder

.PHONY: setup demo network test test-all test-fast test-other messages coverage slowest check format docs docs-serve bench trust \
	lock clean

setup: $(READY)

$(BASE): pyproject.toml requirements.lock
	@$(PYTHON) scripts/check_python.py
	@echo "Setting up $(VENV) with $$($(PYTHON) --version): some 400 MB to download"
	@$(PYTHON) -m venv $(VENV)
	$(call patiently,$(PIP) --upgrade pip && $(PIP) --constraint requirements.lock --editable .)
	@touch $@

# LEARN= leaves PyTorch, Warp and the tests that need them out.
LEARN ?= requirements-learn.lock

$(READY): $(BASE) $(LEARN)
	@echo "Adding the tools of development and every extra but PyTorch and Warp: some 300 MB to download"
	@$(if $(LEARN),echo "and PyTorch and Warp: 2.7 GB with CUDA or 0.4 GB for a CPU build")
	$(call patiently,$(PIP) -r requirements.lock $(addprefix -r ,$(LEARN)))
	@touch $@

demo: $(BASE)
	$(BIN)/tacgen collect quickstart --out out/quickstart
	@echo "Look at out/quickstart/index.html"

network: setup
	$(BIN)/tacgen collect stability --out out/stability
	$(BIN)/tacgen train train_single_small --data out/stability --out out/network
	@echo "Ask it: .venv/bin/tacgen predict out/network IMAGE... --object cup"

test: setup
	$(PYTEST) -m "not exhaustive"

test-all: setup
	$(PYTEST)

test-fast: setup
	$(PYTEST) -m "not slow"

# Physics and imports alone, for a second Python.
test-other: setup
	$(PYTEST) -m "not slow" tests/physics tests/test_architecture.py

# The approved messages anew, of all tests that hold one; read the diff.
messages: setup
	TACGEN_APPROVE_MESSAGES=1 $(PYTEST) $$(grep -rlE '\b(refused|warned)\(' tests validation/tests --include=test_*.py)

coverage: setup
	$(PYTEST) -m "not slow" --cov=tacgen --cov-report=term:skip-covered

slowest: setup
	$(PYTEST) --durations 30

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "Look at it with \`make docs-serve\`; opened as files, its pages have no search"

docs-serve: docs
	$(BIN)/python -m http.server --bind 127.0.0.1 --directory out/site 8000

bench: setup
	$(BIN)/tacgen bench

trust: setup
	$(BIN)/python -m validation.contact

lock: setup
	$(BIN)/uv pip compile pyproject.toml --extra dev --extra cluster --extra parquet --extra view --extra mcap --extra gym --extra docs --universal --python-version 3.11 --no-header --no-annotate --quiet --upgrade --output-file requirements.lock
	@echo "requirements-learn.lock pins torch by hand: its CPU and CUDA builds share a version"

clean:
	rm -rf $(VENV) build dist *.egg-info out
