# `make` prints what there is. Nothing is needed but Python 3.11; PYTHON names it where it is not on the path.
PYTHON ?= $(shell command -v python3.11 || command -v python3 || echo python3.11)

VENV := .venv
BIN := $(VENV)/bin
LOCAL := $(BIN)/python -m services.local
PYTEST := OMP_NUM_THREADS=1 MLFLOW_DISABLE_TELEMETRY=true RAY_USAGE_STATS_ENABLED=0 ORT_DISABLE_TELEMETRY=1 $(BIN)/python -m pytest
# Test files side by side: one process a core, and two of those that start real services. Those that end services
# while jobs run have the machine for themselves: they wait for jobs by the clock.
SIDE_BY_SIDE := -n auto --maxprocesses 4 --dist loadfile
TWO_AT_A_TIME := -n 2 --dist loadfile
INSTALLED := $(VENV)/installed
SITE := OMP_NUM_THREADS=1 MPLBACKEND=agg $(BIN)/python -m sphinx -W --keep-going -E -q -c docs/site -d build/docs-state

FAST := not slow and not e2e and not compose and not browser and not gpu
ALL := not compose and not gpu

.DEFAULT_GOAL := help
.PHONY: help venv demo quickstart test test-all check format docs docs-links up down status env clean-state

help: ## print this
	@echo "make TARGET, with"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo "Settings (environment): CSPACE_HOME, CSPACE_API_PORT, CSPACE_RAY_PORT, CSPACE_MLFLOW_PORT, PYTHON, and"
	@echo "PYTEST_ADDOPTS for the tests. make ends with 2 whatever failed and prints the command's own code as"
	@echo "\`Error N\`; \`$(LOCAL) --help\` tells what the codes mean."

venv: $(INSTALLED) ## make .venv with the pinned packages (2-5 minutes the first time)

demo: $(INSTALLED) ## the API on the shipped models alone, and its page in a browser; nothing is trained
	@$(LOCAL) demo

quickstart: $(INSTALLED) ## the main job: start services, train, evaluate, promote, serve, plan; WORLD=panda for that arm
	@$(LOCAL) quickstart $(if $(WORLD),--world "$(WORLD)")

up: $(INSTALLED) ## start MLflow, Ray and the API; print their addresses and how to set a shell up
	@$(LOCAL) up

down: $(INSTALLED) ## end exactly what was started
	@$(LOCAL) down

status: $(INSTALLED) ## what runs, and how big the state folder is; fails unless everything is healthy
	@$(LOCAL) status

env: $(INSTALLED) ## print the lines that set a shell up: eval "$(make -s env)"
	@$(LOCAL) env

clean-state: $(INSTALLED) ## delete runs, models, data and logs (asks; YES=1 does not)
	@$(LOCAL) clean-state $(if $(YES),--yes)

test: $(INSTALLED) ## the fast tests, under 5 minutes; the documents' code runs with make check
	$(PYTEST) -m "$(FAST)" $(SIDE_BY_SIDE) --ignore=docs --ignore=README.md --ignore=tests/docs

test-all: $(INSTALLED) ## all tests that need neither a container engine nor a GPU; wants Chromium
	$(PYTEST) -m "$(FAST)" $(SIDE_BY_SIDE)
	$(PYTEST) -m "$(ALL) and (slow or e2e or browser)" $(TWO_AT_A_TIME) --ignore=tests/chaos
	$(PYTEST) -m "$(ALL) and (slow or e2e or browser)" tests/chaos

check: $(INSTALLED) ## format, lint, types, import rules, images, compose file, manifests, code in the documents
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/hadolint docker/*.Dockerfile
	$(PYTEST) -q -m "$(FAST)" $(SIDE_BY_SIDE) tests/compose $(wildcard README.md docs tests/docs)

format: $(INSTALLED) ## mend format and lint where a tool can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# What is built is read anew each time: pages are made of the code, and Sphinx looks at files alone.
docs: $(INSTALLED) ## build the documentation site into build/docs, warnings as errors; the API serves it at /guide
	rm -rf build/docs docs/gallery
	$(SITE) -b html docs build/docs
	@echo "build/docs/index.html"

docs-links: $(INSTALLED) ## follow the documents' links to other sites as well, which needs the internet
	$(SITE) -b linkcheck docs build/docs-links

# The last line of pip's output carries its exit code through the pipe; its whole output is kept in a log.
# Ray starts its processes by a shell that is given their paths without quotes.
$(INSTALLED): pyproject.toml clients/python/pyproject.toml constraints.txt
	@case "$$(pwd -P)" in *[]\[[:space:]\"\'\`\$$\&\;\(\)\<\>\|\*\?\#\\\:]*) \
	  echo "Ray cannot run below the folder '$$(pwd -P)': its path has a space or a character of the shell." >&2; \
	  echo "Move the project to a path without one, such as ~/cspace-sampler, and run make again there." >&2; \
	  exit 1;; esac
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null || { \
	  echo "Python 3.11 is needed and '$(PYTHON)' is not it: install it, or name it with make PYTHON=/path/to/python3.11" >&2; \
	  exit 1; }
	@test ! -e $(BIN)/python || $(BIN)/python -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || { \
	  echo "$(VENV) holds another Python: delete the folder and run make again" >&2; exit 1; }
	@test -x $(BIN)/python || { echo "making $(VENV) with $(PYTHON)"; "$(PYTHON)" -m venv $(VENV); } || { \
	  echo "the environment could not be made (on Debian: apt install python3.11-venv)" >&2; exit 1; }
	@echo "installing the packages of constraints.txt, 2-5 minutes the first time; log $(VENV)/install.log"
	@{ PYTHONUNBUFFERED=1 PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip install --progress-bar off \
	  -c constraints.txt -e ./clients/python -e '.[dev]' 2>&1; echo "exit $$?"; } | awk ' \
	  /^exit [0-9]+$$/ { code = $$2; next } \
	  { print > "$(VENV)/install.log"; end[NR % 20] = $$0 } \
	  /^(Collecting|Requirement already satisfied)/ && ++found % 25 == 0 { print "  " found " requirements found"; fflush() } \
	  /^Installing collected/ { print "  installing"; fflush() } \
	  END { if (code != 0) for (i = NR - 19; i < NR; i++) print end[i % 20]; exit code }' >&2
	@touch $@
