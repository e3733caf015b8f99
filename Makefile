# Two commands do it all: `make demo` runs the main job, `make test` passes the tests. Both set up what they need.
.PHONY: help setup demo test test-all lint types matrix bench webodm clean
PY = .venv/bin/python
DEMO = demo

help:
	@echo "make demo      render a mixed survey and run the main job on it"
	@echo "make test      lint, types and tests (also under Python 3.9 where there is one)"
	@echo "make test-all  the same with the long stories"
	@echo "make matrix    the tests under every Python from 3.9 to 3.13 that is here (QUICK=1: the gate and the main job)"
	@echo "make bench     one table: gate, harmonize, align, submit beside the alternatives (FULL=1: all sizes)"
	@echo "make webodm    write dist/sensorgate.zip, the plugin for WebODM"
	@echo "make setup     only the set-up (.venv)"

setup:
	@.ci/setup

demo: setup
	@rm -rf $(DEMO)
	@echo "rendering a mixed survey into $(DEMO)/survey"
	@$(PY) -m tests.simulator demo $(DEMO)/survey
	@.venv/bin/sensorgate run $(DEMO)/survey/images --out $(DEMO)/result --gcp $(DEMO)/survey/gcp_list.txt; \
	  code=$$?; test $$code -le 1 || exit $$code
	@echo "open $(DEMO)/result/report.html"

lint:
	@$(PY) -m ruff check .
	@$(PY) -m ruff format --check .
	@$(MAKE) -s types

types:
	@mkdir -p build/typing && ln -sfn ../.. build/typing/sensorgate
	@MYPYPATH=build/typing $(PY) -m mypy --explicit-package-bases -p sensorgate.stages

webodm: setup
	@mkdir -p dist
	@.venv/bin/sensorgate webodm --out dist/sensorgate.zip

test: setup lint
	@$(PY) -m pytest -m "not slow"
	@.ci/test39

test-all: setup lint
	@$(PY) -m pytest
	@.ci/test39

matrix: setup
	@$(PY) .ci/matrix $(if $(QUICK),--quick)

bench: setup
	@$(PY) benchmarks/run_all.py $(if $(FULL),--full)

clean:
	rm -rf build dist demo *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
