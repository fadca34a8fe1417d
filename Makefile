# `make run`, `make test` and `make docs` set up .venv on their own; nothing but Python, pip and make is needed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PART ?= newton_euler/equations tests/newton_euler/equations

.PHONY: run test test-slow mutants lint figures snapshots pictures docs clean

run: $(VENV)/installed
	$(BIN)/crosscheck run tracker

test: lint
	$(BIN)/python -m pytest -n auto

test-slow: $(VENV)/docs-installed $(VENV)/engines-installed
	$(BIN)/python -m pytest -m slow

# of another part, for one: make mutants PART="crosscheck/compare tests/crosscheck/compare --count 30"
mutants: $(VENV)/mutants-installed
	$(BIN)/python tests/support/mutants.py $(PART)

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

figures: $(VENV)/installed
	$(BIN)/crosscheck figures

# what commands print and write, with which tests/test_snapshots.py compares
snapshots: $(VENV)/installed
	$(BIN)/python tests/support/snapshots.py

# needs Chromium and, for Rerun, a Vulkan driver, as Debian's chromium, mesa-vulkan-drivers and libvulkan1
pictures: $(VENV)/docs-installed
	$(BIN)/python tests/support/pictures.py

docs: $(VENV)/docs-installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev,sun,sweep]"
	# bytecode, as pip makes it of what is not editable: 0.2 s of every command where Python may not write them
	$(BIN)/python -m compileall -q newton_euler mjcf urdf crosscheck
	touch $@

# the optional engines and backends; processors and systems without their wheels skip their tests
$(VENV)/engines-installed: $(VENV)/installed
	for engine in drake exudyn mjx; do \
		$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary $$engine -c constraints.txt \
			-e ".[$$engine]" || echo "$$engine: no wheel for this system, its tests are skipped"; \
	done
	touch $@

$(VENV)/docs-installed: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[docs]"
	touch $@

$(VENV)/mutants-installed: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[mutants]"
	touch $@

clean:
	rm -rf $(VENV) output
