# Everything one does with this repository; `make` alone lists it.
# Works with GNU make 3.81 (macOS) and later.

PYTHON ?= python3
TORCH := 2.13.0
PICTURE_CASE := 28
TEAM := samarl_planned

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input --quiet --quiet
STAMP := $(VENV)/.installed
MANY_WORLDS := --rounds 2 trainer.threads=1 'curriculum.stages=[ \
  {worlds: 192, scenario: {humans: 10, robots: 3}},{worlds: 192, scenario: {humans: 10, robots: 5}}]'
SWEEP := $(BIN)/samarl-evaluate -m evaluation.cases=200 hydra.sweep.dir=outputs/sweeps

# The first table after a heading of results/NAME.md goes between the README's marks of that name.
INTO_README = @awk -v mark='$(1)' -v heading='$(2)' ' \
  FNR == NR { if ($$0 == heading) here = 1; \
              if (here && /^\|/) table = table $$0 "\n"; else if (table) here = 0; next } \
  $$0 == "<!-- " mark " -->" { print; printf "%s", table; inside = 1; next } \
  $$0 == "<!-- /" mark " -->" { inside = 0 } \
  !inside' results/$(1).md README.md > README.md.part && mv README.md.part README.md

.DEFAULT_GOAL := help
.PHONY: help setup bench test test-browser lint train results sweeps pictures report docs latency throughput soak malformed kills wheel check-wheel clean

help: ## List what can be made
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "Each sets up .venv first if need be, with $(PYTHON) (another one: make PYTHON=python3.13 ...)."

# What is installed is known by content, not by date: a .venv that was kept from an earlier
# checkout is used again if it was made here, by the same Python, and installs what is missing.
# Modules are compiled when they are first imported: most of them never are.
setup: ## Install everything into .venv, unless it is there
	@set -e; version='import sys; print("%d.%d" % sys.version_info[:2])'; \
	python=$$($(PYTHON) -c "$$version" 2>/dev/null) || python="not found"; \
	case "$$python" in 3.11|3.12|3.13) ;; *) echo "error: $(PYTHON) is $$python; Python 3.11, 3.12 or" \
	  "3.13 is needed, say which: make PYTHON=python3.13" >&2; exit 1;; esac; \
	home="$(CURDIR) Python $$python"; \
	wanted="$$(echo "$$home"; echo "torch $(TORCH)"; cat pyproject.toml constraints.txt)"; \
	there=$$($(BIN)/python -c "$$version" 2>/dev/null) || there=nothing; \
	if [ "$$there" = "$$python" ] && [ "$$wanted" = "$$(cat $(STAMP) 2>/dev/null)" ]; then exit 0; fi; \
	start=$$(date +%s); \
	echo "Setting up .venv with Python $$python (once; torch takes minutes) ..."; \
	if [ "$$there" != "$$python" ] || { [ -f $(STAMP) ] && [ "$$home" != "$$(head -n 1 $(STAMP))" ]; }; \
	then $(PYTHON) -m venv --clear $(VENV); fi; \
	echo "  torch $(TORCH)"; $(PIP) install --no-compile "torch==$(TORCH)"; \
	echo "  everything else, at the versions of constraints.txt"; \
	$(PIP) install --no-compile -c constraints.txt -e ".[dev]"; \
	echo "$$wanted" > $(STAMP); \
	echo "Set up in $$(($$(date +%s) - start)) s."

bench: setup ## Play Table I (TABLE=table2: MSA3C's) and compare with results/ (minutes)
	@$(BIN)/samarl-bench $(if $(TABLE),table=$(TABLE)) $(if $(CASES),evaluation.cases=$(CASES)) \
	  $(if $(LEARNED_CASES),learned_cases=$(LEARNED_CASES))

test: setup ## Run the tests on all cores
	@$(BIN)/pytest -n auto --maxprocesses 8 --durations 20

test-browser: setup ## Test the report in a headless Chromium, which must be installed
	@$(BIN)/pytest -m browser -n auto --maxprocesses 2

lint: setup ## Check style and types
	@echo "ruff ..."; $(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@echo "mypy ..."; $(BIN)/mypy

train: setup ## Train SAMARL with the default recipe, or go on with an interrupted training (an hour)
	@$(BIN)/samarl-train

results: setup ## Rewrite results/ and the README's table and pictures (RECORDINGS=folder: people, too)
	@$(BIN)/samarl-bench seeds=true output=results
	@$(BIN)/samarl-bench table=table2 seeds=true output=results
	@$(BIN)/samarl-bench table=ablations output=results
	@$(BIN)/samarl-bench table=robustness output=results
	@$(BIN)/samarl-bench table=transfer output=results \
	  $(if $(RECORDINGS),recordings=$(RECORDINGS),merge=true)
	@$(BIN)/samarl-predictor predictor=recurrent output=results \
	  $(if $(RECORDINGS),recordings=$(RECORDINGS))
	@$(BIN)/python -m benchmarks.throughput --compile --output results/throughput.json
	@$(BIN)/python -m benchmarks.latency --output results/latency.json
	@$(BIN)/python -m benchmarks.training --output results/training_throughput.json
	@OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.training $(MANY_WORLDS) \
	  --output results/training_throughput_1_process.json
	@OMP_NUM_THREADS=1 $(BIN)/torchrun --nproc-per-node 2 --no-python $(BIN)/python \
	  -m benchmarks.training $(MANY_WORLDS) --output results/training_throughput_2_processes.json
	$(call INTO_README,table1,# Table I)
	$(call INTO_README,transfer,### Recorded people)
	@$(MAKE) --no-print-directory pictures

sweeps: setup ## Play the sweeps of results/sweeps/ (hours; the same again goes on)
	@$(SWEEP)/crowds agent=samarl,perimeter,model_predictive \
	  scenario.fov_degrees=60,90,135,180,270,360 scenario.humans=0,5,10,15,20 scenario.robots=1,2,3,5,8
	@$(SWEEP)/team_view agent=$(TEAM) scenario.fov_degrees=60,90,120,180,270,360 \
	  scenario.team_perception=none,tracks
	@$(SWEEP)/team_size agent=$(TEAM) scenario.fov_degrees=90 scenario.robots=2,3,5,8 \
	  scenario.team_perception=none,tracks
	@$(SWEEP)/team_range agent=$(TEAM) scenario.fov_degrees=90 scenario.team_perception=tracks \
	  scenario.team_range=2,4,6,8,10,20
	@$(SWEEP)/team_delay agent=$(TEAM) scenario.fov_degrees=90 scenario.team_perception=tracks \
	  scenario.team_delay=0,0.25,0.5,1,2
	@$(SWEEP)/team_loss agent=$(TEAM) scenario.fov_degrees=90 scenario.team_perception=tracks \
	  scenario.team_loss=0,0.25,0.5,0.75,0.95
	@mkdir -p results/sweeps; for table in outputs/sweeps/*/table.json; do \
	  cp "$$table" results/sweeps/$$(basename $$(dirname "$$table")).json; done

pictures: report ## Draw the pictures of the README: a case that plays, and the table as a figure
	@$(BIN)/samarl-render agent=samarl against=orca case=$(PICTURE_CASE) output=docs/images/case.gif
	@cp results/report/figures/table-1.png docs/images/table1.png
	@cp results/report/figures/transfer-recorded-people.png docs/images/recorded.png

report: setup ## Build pages for the browser from results/, with replays, in results/report/
	@$(BIN)/samarl-report

docs: setup ## Build the documentation, with the Python API, in outputs/docs/
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "written to outputs/docs/index.html"

latency: setup ## Measure how long one decision takes
	@$(BIN)/python -m benchmarks.latency

throughput: setup ## Measure world-steps per second (a minute)
	@$(BIN)/python -m benchmarks.throughput --compile

soak: setup ## Drive worlds at random for 1e9 steps (an hour; the same again goes on)
	@$(BIN)/python -m benchmarks.soak

malformed: setup ## Load 10,000 malformed files and configurations: no traceback, no hang (minutes)
	@$(BIN)/python -m benchmarks.malformed

kills: setup ## Kill a training and a sweep a hundred times: nothing may be lost (half an hour)
	@$(BIN)/python -m benchmarks.kills

wheel: setup ## Build the wheel into dist/
	@$(BIN)/python -m build --quiet --wheel --outdir dist .
	@ls dist/*.whl

check-wheel: wheel ## Install the wheel into an environment of its own and run it there (minutes)
	@set -e; start=$$(date +%s); folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; \
	wheel=$$(ls -t "$(CURDIR)"/dist/samarl-*.whl | head -n 1); \
	pip="$$folder/venv/bin/python -m pip --disable-pip-version-check --no-input --quiet --quiet"; \
	echo "Installing $$(basename "$$wheel") into an environment of its own (torch takes minutes) ..."; \
	$(PYTHON) -m venv "$$folder/venv"; \
	$$pip install "torch==$(TORCH)"; \
	$$pip install -c constraints.txt "$$wheel"; \
	cd "$$folder"; PATH="$$folder/venv/bin:$$PATH"; export PATH; \
	samarl-evaluate agent=orca evaluation.cases=5; \
	samarl-predictor predictor=recurrent validation_cases=5; \
	samarl-recording "$$(python -c 'import mrsan.recording as r; print(r.SAMPLE)')" --figure people.png; \
	samarl-bench agents='[straight]' evaluation.cases=5 output=bench > bench.txt; \
	python -c "import os, mrsan, samarl; from samarl.files import find_folder; \
	home = os.path.realpath('venv') + os.sep; \
	places = [samarl.__file__, mrsan.__file__, *map(str, map(find_folder, ('conf', 'results')))]; \
	wrong = [p for p in places if not (os.path.realpath(p).startswith(home) and os.path.exists(p))]; \
	assert not wrong, wrong"; \
	echo "The wheel works: checked in $$(($$(date +%s) - start)) s."

clean: ## Remove dist/ and caches (.venv and outputs/ stay)
	@rm -rf dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +
