# Everything runs in .venv, which `setup` makes from the lock files; `demo` needs no extra.
PYTHON ?= $(shell for p in python3.11 python3.10 python3; do $$p -c 'import venv' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
BASE := .venv/.base
READY := .venv/.ready
# A test process is one core's work: libraries that start threads in each slow one another down.
# One more than cores, since some tests wait for processes of their own.
# Tests start many processes, which shall not compile the package each.
PYTEST := OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= \
	$(BIN)/python -m pytest -n $(shell echo $$(($$(getconf _NPROCESSORS_ONLN) + 1))) --dist worksteal

.PHONY: setup demo network test test-fast coverage slowest check format docs bench trust lock clean

setup: $(READY)

$(BASE): pyproject.toml requirements.lock
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint requirements.lock --editable .
	touch $@

$(READY): $(BASE) requirements-learn.lock
	$(BIN)/python -m pip install --quiet -r requirements.lock -r requirements-learn.lock
	touch $@

demo: $(BASE)
	$(BIN)/tacgen collect quickstart --out out/quickstart --workers 2
	@echo "Look at out/quickstart/index.html"

network: setup
	$(BIN)/tacgen collect stability --out out/stability --workers 2
	$(BIN)/tacgen train train_single_small --data out/stability --out out/network --workers 2
	@echo "Ask it: .venv/bin/tacgen predict out/network IMAGE... --object cup"

test: setup
	$(PYTEST)

test-fast: setup
	$(PYTEST) -m "not slow"

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
	@echo "Look at out/site/index.html"

bench: setup
	$(BIN)/tacgen bench

trust: setup
	$(BIN)/python -m validation.contact

lock: setup
	$(BIN)/uv pip compile pyproject.toml --extra dev --extra cluster --extra mujoco --extra view --extra docs --universal --python-version 3.10 --no-header --no-annotate --quiet --upgrade --output-file requirements.lock
	@echo "requirements-learn.lock pins torch by hand: its CPU and CUDA builds share a version"

clean:
	rm -rf .venv build dist *.egg-info out
