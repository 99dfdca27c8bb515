# Run `make` to list all targets. Works with GNU make 3.81 (macOS) and later.

PYTHON ?= python3
PICTURE_CASE := 28
NARROW_DOOR := scenario=narrow_doorway scenario.team_messages=true
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input -qq install --no-compile
PARALLEL := -n auto --maxprocesses 8 --dist worksteal --durations 20

.DEFAULT_GOAL := help
.PHONY: help setup bench test test-all test-browser lint train results sweeps pictures report docs \
  latency throughput soak physics malformed kills wheel check-wheel clean python

help: ## List all targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))
	@echo "Every target first sets up .venv if necessary. PYTHON names its interpreter (3.11 to 3.13):"
	@echo "  make test PYTHON=python3.13"

setup: .venv/.installed ## Install the project and its dependencies into .venv, unless they are up to date

# Torch comes first, at its exact version: pip would prefer another build of it.
.venv/.installed: pyproject.toml constraints.txt | python
	@echo "Setting up .venv (once; torch takes minutes) ..."
	@$(PYTHON) -m venv .venv
	@$(PIP) $$(grep '^torch==' constraints.txt)
	@$(PIP) -c constraints.txt -e '.[dev]'
	@touch $@

bench: setup ## Evaluate the README's rows of Table I, 100 cases each (2 minutes); FULL=1: all rows and cases
	@$(BIN)/samarl-bench $(if $(TABLE),table=$(TABLE),$(if $(FULL),,only_headline=true)) \
	  $(if $(CASES)$(FULL),$(if $(CASES),evaluation.cases=$(CASES)),evaluation.cases=100) \
	  $(if $(LEARNED_CASES),learned_cases=$(LEARNED_CASES))

test: setup ## Run the tests on all cores, without the slow ones (5 minutes on two cores)
	@$(BIN)/pytest $(PARALLEL)

test-all: setup ## Run all tests, also the slow ones (examples, kills, films)
	@$(BIN)/pytest -m "not browser" $(PARALLEL)

test-browser: setup ## Test the report in headless Chromium, which must be installed
	@$(BIN)/pytest -m browser -n auto --maxprocesses 2

lint: setup ## Check style and types
	@$(BIN)/ruff check . && $(BIN)/ruff format --check .
	@$(BIN)/mypy

train: setup ## Train two levels with the default recipe on two cores, or resume an interrupted training (12 minutes)
	@$(BIN)/samarl-train trainer.processes=2 trainer.threads=1

results: setup ## Rewrite results/ and the figures in the documentation (RECORDINGS=folder of recordings)
	@$(BIN)/python -m tools.rewrite_results $(if $(RECORDINGS),--recordings $(RECORDINGS))
	@$(MAKE) --no-print-directory pictures

sweeps: setup ## Evaluate the sweeps of results/sweeps/, or resume them (hours)
	@$(BIN)/python -m tools.run_sweeps

pictures: setup ## Draw the pictures of the documentation: layouts, tables as figures and an animated case
	@$(BIN)/python -m tools.draw_layouts docs/images
	@$(BIN)/samarl-report cases=[] output=outputs/pictures
	@cp outputs/pictures/figures/table-1.png docs/images/table1.png
	@cp outputs/pictures/figures/transfer-recorded-people.png docs/images/recorded.png
	@$(BIN)/samarl-render agent=samarl against=orca case=$(PICTURE_CASE) output=docs/images/case.gif
	@$(BIN)/samarl-render agent=samarl against="samarl right_of_way=null" case=22 $(NARROW_DOOR) output=docs/images/right_of_way.gif

report: setup ## Build web pages with tables, curves and replays in results/report/
	@$(BIN)/samarl-report

docs: setup ## Build the documentation, with the Python API, in outputs/docs/
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@$(BIN)/python -m tools.record_session outputs/docs/play
	@echo "written to outputs/docs/index.html"

latency: setup ## Measure how long one decision takes
	@$(BIN)/python -m benchmarks.latency

throughput: setup ## Measure world-steps per second and first starts (3 minutes)
	@$(BIN)/python -m benchmarks.throughput --cold

soak: setup ## Step worlds with random actions 1e9 times, or resume an interrupted run (an hour)
	@$(BIN)/python -m benchmarks.soak

places: setup ## Certify 10,000 cases of each family of places, and watch people walk there (half an hour)
	@$(BIN)/python -m benchmarks.places

physics: setup ## Play cases in MuJoCo beside the simulator, or resume an interrupted run (an hour)
	@$(BIN)/python -m benchmarks.physics

malformed: setup ## Damage files and settings in 10,000 ways: no traceback, no hang (minutes)
	@$(BIN)/pytest -n auto --maxprocesses 8 --hypothesis-profile malformed tests/test_malformed.py

kills: setup ## Kill a training and a sweep a hundred times: nothing may be lost (half an hour)
	@$(BIN)/python -m benchmarks.kills

wheel: setup ## Build the wheel in dist/
	@$(BIN)/python -m build --quiet --wheel --outdir dist .
	@ls dist/*.whl

check-wheel: wheel ## Install the wheel into a fresh environment and run its commands (minutes)
	@$(BIN)/python -m tools.check_wheel

clean: ## Remove dist/ and caches, but not .venv or outputs/
	@rm -rf dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -not -path './.venv/*' -prune -exec rm -rf {} +

python:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2> /dev/null || \
	  { echo "error: PYTHON is $(PYTHON); it must be Python 3.11 to 3.13: make PYTHON=python3.13" >&2; exit 1; }
