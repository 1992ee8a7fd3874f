# make demo   the CubeSat study in a fresh virtual environment
# make claims all five studies, and the page of what became of the papers' claims
# make test   everything that CI runs as tests
# make check  formatting, lint, types, import contracts

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check
OUT    ?= out/cubesat3u

.PHONY: demo claims test check clean

demo: $(VENV)/run.stamp
	$(BIN)/python examples/cubesat3u/cubesat3u.py --out $(OUT)

STUDIES := cubesat3u/cubesat3u amazonia1/amazonia1 amazonia1/amazonia1_region airbearing/airbearing geo/geo

claims: $(VENV)/run.stamp
	for study in $(STUDIES); do $(BIN)/python examples/$$study.py --out out/$$(basename $$study) || exit; done
	$(BIN)/python -m plants.outcome.claimspage $(addprefix out/,$(notdir $(STUDIES)))

test: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -n 2 --dist loadfile

check: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

$(VENV)/run.stamp: pyproject.toml requirements/run.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) --require-hashes -r requirements/run.txt
	$(PIP) --no-deps --no-build-isolation -e .
	touch $@

# the oracles have no wheel for every platform; the tests that compare with them skip without them
$(VENV)/dev.stamp: $(VENV)/run.stamp requirements/dev.txt requirements/oracles.txt
	$(PIP) --require-hashes -r requirements/dev.txt
	$(PIP) --require-hashes --only-binary slycot,pymsis -r requirements/oracles.txt || echo "slycot, fmpy or pymsis is not to be had here: their comparisons will be skipped"
	touch $@

clean:
	rm -rf $(VENV) out dist build
