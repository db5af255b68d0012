# All targets need nothing but Python 3.11 or newer (with venv): they make their own virtual environment in .venv.
PYTHON ?= python3
BIN := .venv/bin
DOCS := docs
SITE := out/site

# Tests start some hundred processes: with bytecode on disk each of them is there in half the time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo docs test test-exhaustive test-all test-gate measured drivers study-kills fuzz kills attacks clean

demo: .venv/installed
	$(BIN)/clsim run examples/circle.toml -o out/demo --force
	@echo "The spectrogram is in out/demo/ceiling_spectrogram.png, the sound in out/demo/ceiling.wav, the path table in out/demo/paths.npz"

# Tests run several at a time: threads of linear algebra would only wait for each other.
test test-exhaustive test-all test-gate measured: export OPENBLAS_NUM_THREADS = 1

# What runs at every change. What is long and seldom fails is in `test-exhaustive`, of which this has a few of each kind.
test: .venv/tested
	$(BIN)/python -m pytest

# Many of these wait for processes that they start: three at a time.
test-exhaustive: .venv/tested
	$(BIN)/python -m pytest -m exhaustive -n 3

# Both at once, each test once. Three at a time were not quicker here.
test-all: .venv/tested
	$(BIN)/python -m pytest -m ""

# What the gate runs: `test-all` without most of what is drawn at random.
test-gate: .venv/tested
	$(BIN)/python -m pytest -m "not long"

# The figures in docs/validation.md, by all tests that note one: some minutes.
measured: .venv/tested
	CLSIM_MEASURED=$(CURDIR)/out/measured $(BIN)/python -m pytest -m "" --measuring
	$(BIN)/python docs/site/figures.py out/measured

# All scenes in both layouts on Intel's CPU runtime and in Oclgrind, where they are installed: some minutes.
drivers: .venv/tested
	$(BIN)/python -m pip install --quiet --editable '.[drivers]'
	CLSIM_ALL_DRIVERS=1 $(BIN)/python -m pytest -m "" tests/drivers

# Fifty workers of studies killed at random: some minutes.
study-kills: .venv/tested
	STUDY_KILLS=50 $(BIN)/python -m pytest -m "" -n 0 tests/integration/test_study_killed.py -k killed_at_random

fuzz: .venv/tested
	CLSIM_FUZZ=20000 $(BIN)/python -m pytest -m "" -n 2 --dist load tests/integration/test_fuzz.py

# Commands killed at 200 random moments, and interrupted at 150, of which the exhaustive tests have a few; some minutes.
kills: .venv/tested
	CLSIM_KILLS=200 CLSIM_INTERRUPTS=150 $(BIN)/python -m pytest -m "" -n 0 tests/integration/test_kills.py tests/integration/test_interrupts.py

# Damaged results, files of others in the way, full disks (as root), and many renders in one process: some twenty minutes.
attacks: .venv/tested
	CLSIM_DAMAGED=1448 CLSIM_FOREIGN=132 CLSIM_DISKS=30 CLSIM_RENDERS=570 CLSIM_THREADS=96 $(BIN)/python -m pytest -m "" -n 2 --dist load \
		tests/integration/test_damaged_results.py tests/integration/test_full_disks.py tests/integration/test_many_renders.py

# The site is in out/site: open out/site/index.html.
docs: .venv/documented
	$(BIN)/python -m sphinx --builder html --fail-on-warning --quiet --conf-dir $(DOCS)/site --doctree-dir out/doctrees $(DOCS) $(SITE)

.venv/documented: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@ .venv/installed

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/installed: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[pictures]'
	@touch $@

.venv/tested: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[test,check]'
	@touch $@ .venv/installed

clean:
	rm -rf .venv out
