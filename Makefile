# Two commands matter: `make demo` (the main job, needs no ROS) and `make test` (everything).
# Each prepares .venv by itself; nothing has to be installed by hand.
.DEFAULT_GOAL := help
SHELL := /bin/bash
BIN := .venv/bin
READY := .venv/.ready
RUNTIME := .venv/.runtime
# Test processes: most of the time of a test that starts programs is waiting.
WORKERS ?= 2

.PHONY: help demo quick test attacks check static cover report bench man ros format clean
help:
	@echo "make demo    the main job, end to end, in under 30 s (no ROS needed)"
	@echo "make quick   formatting, lint, types and the fast unit tests: for the desk, without apt and ROS"
	@echo "make test    the whole suite (installs Debian's ROS packages and Chromium when it can)"
	@echo "make attacks the attacks of docs/threat-model.md alone"
	@echo "make static  formatting, lint, types, import contracts, wheel contents"
	@echo "make cover   the unit tests with their coverage gates"
	@echo "make report  after make cover: which modules the tests of their own folder cover least"
	@echo "make check   make static and make cover"
	@echo "make man     the manual pages, in build/man (the wheel has them)"
	@echo "make bench   measurements beside plain TCPROS and TLS (BENCH=name for one)"

$(READY): pyproject.toml constraints.txt tools/venv.sh
	@tools/venv.sh

# The demo needs none of the packages that tests and development need.
$(RUNTIME): pyproject.toml constraints.txt tools/venv.sh
	@tools/venv.sh runtime

# ROS packages first: they decide which Python the venv is made from.
ros:
	@tools/ros-packages.sh

demo: $(RUNTIME)
	@$(BIN)/rossec demo
	@echo "(here: $(BIN)/pip install -e '.[console]' and $(BIN)/rossec console --demo)"

# Not in it: what needs ROS, a browser or a network of its own, and the slowest files (tests/slow.txt).
quick: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q -n $(WORKERS) --quick $(ARGS) tests/ca tests/grants tests/rossec

# The venv is looked at after the ROS packages: installing them may bring a better Python for it. CI measures coverage
# besides (COVER=1): unit tests alone must cover the packages, integration tests only add confidence.
test: ros
	@tools/venv.sh
ifdef COVER
	$(MAKE) cover
else
	$(BIN)/python -m pytest -q -n $(WORKERS) $(ARGS) tests/ca tests/grants tests/rossec
endif
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile $(ARGS) --ignore tests/ca --ignore tests/grants --ignore tests/rossec

attacks: ros
	@tools/venv.sh
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile $(ARGS) tests/attacks

cover: ros
	@tools/venv.sh
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -q -n $(WORKERS) $(ARGS) tests/ca tests/grants tests/rossec
	$(BIN)/coverage combine -q
	$(BIN)/coverage report

report: $(READY)
	$(BIN)/python tools/own_tests.py

static: ros
	@tools/venv.sh
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	tools/wheel.sh

check: static cover

bench: $(READY)
	$(BIN)/python -m bench $(BENCH)

man: $(READY)
	@$(BIN)/python -m rossec.cli.manual build/man

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf .venv build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage*
