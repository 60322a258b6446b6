# `make` prints what there is. Nothing is needed but a supported Python: the first of these, or the one that PYTHON names.
SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for name in python3.11 python3 python3.12 python3.13; do \
  "$$name" -c '$(SUPPORTED)' 2>/dev/null && { echo "$$name"; break; }; done)
# PyTorch's index for processors gives a torch that is several GB smaller than the one of the default index. Nothing but
# torch is taken from there: an index that supplies every package could replace any of them.
TORCH_INDEX_URL ?=

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
.PHONY: interpreter location help venv demo quickstart arm test test-all check pins hashes audit format docs docs-links up down status env clean-state

help: ## print this
	@echo "make TARGET, with"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo "Settings (environment): CSPACE_HOME, CSPACE_API_PORT, CSPACE_RAY_PORT, CSPACE_MLFLOW_PORT,"
	@echo "CSPACE_VIEWER_PORT, PYTHON, TORCH_INDEX_URL, and PYTEST_ADDOPTS for the tests. make ends with 2 whatever failed"
	@echo "and prints the command's own code as \`Error N\`; \`$(LOCAL) --help\` tells what the codes mean."

venv: $(INSTALLED) ## make .venv with the pinned packages (2-5 minutes the first time)

demo: $(INSTALLED) ## the API on the shipped models, its page in a browser, and the 3D viewer; nothing is trained
	@$(LOCAL) demo

quickstart: $(INSTALLED) ## the main job: start services, train, evaluate, promote, serve, plan; WORLD=panda for that arm
	@$(LOCAL) quickstart $(if $(WORLD),--world "$(WORLD)")

arm: $(INSTALLED) ## your own arm to a served model: URDF=FILE TIP=LINK, and NAME=... UNTRAINED=1 IMPORT="--lock joint=0 ..."
	@$(LOCAL) arm $(if $(UNTRAINED),--untrained )"$(URDF)" $(if $(TIP),--tip "$(TIP)") $(if $(NAME),--name "$(NAME)") $(IMPORT)

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
	$(PYTEST) -m "$(FAST)" $(SIDE_BY_SIDE) tests --ignore=tests/docs

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

# uv goes by each Python's markers, which pip --dry-run does not.
pins: $(INSTALLED) ## constraints.txt resolves for every supported Python and pins all that is installed; wants the internet
	@for version in 3.11 3.12 3.13; do \
	  $(BIN)/uv pip compile --quiet --no-header --no-annotate --only-binary :all: --all-extras -c constraints.txt \
	    --python-version "$$version" --python-platform x86_64-manylinux_2_28 pyproject.toml docker/mlflow.in \
	    > $(VENV)/pins.txt || exit 1; \
	  ! grep -vxF -e clients/python -f constraints.txt $(VENV)/pins.txt || { \
	    echo "Python $$version: these are not pinned in constraints.txt" >&2; exit 1; }; \
	  echo "Python $$version: $$(wc -l < $(VENV)/pins.txt) packages, all pinned"; \
	done

# Of the images: every package with its hashes. torch and the CUDA libraries are apart, for torch may have another index.
LOCK := $(BIN)/uv pip compile --quiet --no-annotate --only-binary :all: --generate-hashes -c constraints.txt \
  --custom-compile-command 'make hashes' --python-version 3.11 --python-platform x86_64-manylinux_2_28
CUDA = $(shell sed -nE 's/^((torch|triton|(nvidia|cuda)-[^=]*)==.*)/\1/p' constraints.txt)

hashes: $(INSTALLED) ## docker/*.txt: what the images install, with hashes, of constraints.txt; wants the internet
	$(LOCK) pyproject.toml --extra api --extra plan --extra signing --extra tracing --no-emit-package cspace-client \
	  -o docker/api.txt
	$(LOCK) docker/mlflow.in -o docker/mlflow.txt
	printf '%s\n' $(CUDA) | $(LOCK) --no-deps - -o docker/torch.txt
	$(LOCK) pyproject.toml --extra train --no-emit-package cspace-client \
	  $(foreach pin,$(CUDA),--no-emit-package $(firstword $(subst ==, ,$(pin)))) -o docker/ray.txt

# --strict: a package that the index of vulnerabilities does not know is an error.
audit: $(INSTALLED) ## known vulnerabilities of what constraints.txt pins, by pip-audit; wants the internet
	@$(BIN)/uv tool run pip-audit --requirement constraints.txt --no-deps --disable-pip --strict || { \
	  echo "Not audited, or something was found: see above. pip-audit asks PyPI's JSON API, which a mirror may lack." >&2; \
	  exit 1; }

format: $(INSTALLED) ## mend format and lint where a tool can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# What is built is read again each time: pages are made of the code, and Sphinx looks at files alone.
docs: $(INSTALLED) ## build the documentation site into build/docs, warnings as errors; the API serves it at /guide
	rm -rf build/docs docs/gallery
	$(SITE) -b html docs build/docs
	@echo "build/docs/index.html"

docs-links: $(INSTALLED) ## follow the documents' links to other sites as well, which needs the internet
	$(SITE) -b linkcheck docs build/docs-links

# Ray starts its processes by a shell that is given their paths without quotes.
location:
	@case "$$(pwd -P)" in *[]\[[:space:]\"\'\`\$$\&\;\(\)\<\>\|\*\?\#\\\:]*) \
	  echo "Ray cannot run below the folder '$$(pwd -P)': its path has a space or a character of the shell." >&2; \
	  echo "Move the project to a path without one, such as ~/cspace-sampler, and run make again there." >&2; \
	  exit 1;; esac

# Without a supported Python nothing else works, and an environment keeps the Python that it was made with.
interpreter:
	@test -e $(BIN)/python || "$(PYTHON)" -c '$(SUPPORTED)' 2>/dev/null || { \
	  echo "Python 3.11, 3.12 or 3.13 is needed and $(if $(PYTHON),'$(PYTHON)' is none of them,none was found): install" \
	    "one, or name it with make PYTHON=/path/to/python3.12" >&2; exit 1; }
	@test ! -e $(BIN)/python || $(BIN)/python -c '$(SUPPORTED)' || { \
	  echo "$(VENV) holds a Python that is not supported: delete the folder and run make again" >&2; exit 1; }
ifneq ($(origin PYTHON),file)
	@test ! -e $(BIN)/python || test "$$($(BIN)/python --version)" = "$$("$(PYTHON)" --version)" || { \
	  echo "$(VENV) was made with $$($(BIN)/python --version) and PYTHON names another: delete the folder, or leave" \
	    "PYTHON out" >&2; exit 1; }
endif

PIP := PYTHONUNBUFFERED=1 PIP_DISABLE_PIP_VERSION_CHECK=1 $(BIN)/python -m pip install --progress-bar off \
  --only-binary :all: -c constraints.txt

# The last line of pip's output carries its exit code through the pipe; its whole output is kept in a log.
$(INSTALLED): pyproject.toml clients/python/pyproject.toml constraints.txt | location interpreter
	@test -x $(BIN)/python || { echo "making $(VENV) with $(PYTHON)"; "$(PYTHON)" -m venv $(VENV); } || { \
	  echo "the environment could not be made (on Debian and Ubuntu: apt install python3-venv)" >&2; exit 1; }
	@echo "installing the packages of constraints.txt, 2-5 minutes the first time; log $(VENV)/install.log"
	@{ $(PIP) pip setuptools 2>&1 \
	  && $(PIP) $(if $(TORCH_INDEX_URL),--index-url "$(TORCH_INDEX_URL)") --no-deps torch 2>&1 \
	  && $(PIP) --no-build-isolation -e ./clients/python -e '.[dev]' 2>&1; echo "exit $$?"; } | awk ' \
	  /^exit [0-9]+$$/ { code = $$2; next } \
	  { print > "$(VENV)/install.log"; end[NR % 20] = $$0 } \
	  /^(Collecting|Requirement already satisfied)/ && ++found % 25 == 0 { print "  " found " requirements found"; fflush() } \
	  /^Installing collected/ { print "  installing"; fflush() } \
	  END { if (code != 0) for (i = NR - 19; i < NR; i++) print end[i % 20]; exit code }' >&2
	@touch $@
