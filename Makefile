# `make demo`, `make test` and `make test-all` need nothing but a Debian or Ubuntu with Python 3.11 or newer.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-for-the-demo
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
SYSTEM_PACKAGES := libegl1 libgl1 libgl1-mesa-dri
TEST_PACKAGES := build-essential chromium cmake postgresql
# every extra of users but rl, whose PyTorch is large
EXTRAS := video,tune,cad,gis,fmi,roads,hil,cluster,sensitivity,export,pandas,zig,dev
TEST_EXTRAS := $(EXTRAS),rl,oracles,docs
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: demo test test-all docs install install-all system system-all lint benchmarks fuzz kills mutations soak soak-hour clean

demo: $(DEMO_STAMP)
	@rm -rf runs/demo
	PYTHONDONTWRITEBYTECODE= $(BIN)/offtrack run roundabout --seed 1 --out runs/demo
	@echo "Open runs/demo/report.html"

# Linters, types and import contracts, and the tests that take no more than minutes.
test: install lint
	$(BIN)/pytest -m "not slow"

# The rest: slow tests, and comparisons with other programs, which are installed. Only Wine, and interpreters of other
# versions of Python, may be missing.
test-all: install-all
	$(BIN)/pytest -m slow --no-skips --dist worksteal

# The site, from the pages and the code: two minutes, without a network once it is installed.
docs: $(STAMP)-docs
	$(BIN)/python -m sphinx -q -W --keep-going -b html -d build/doctrees -c docs . build/site
	@echo "Open build/site/index.html"

$(STAMP)-docs: $(STAMP)
	$(PIP) --editable '.[$(EXTRAS),docs]'
	@touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Processor times against the commit recorded last, and bars; with RECORD=1 the ratios are kept in tests/benchmarks/history.csv
benchmarks: install
	$(BIN)/python -m tests.benchmarks.history $(if $(RECORD),--record)
	$(BIN)/pytest tests/benchmarks --override-ini addopts="--import-mode=importlib" --benchmark-only

# Commands killed at random moments and started again: make kills MOMENTS=40
kills: install
	$(BIN)/python -m tests.kills --moments $(or $(MOMENTS),40)
	$(BIN)/python -m tests.kills.engines

# Changes of single lines that the tests of their modules should notice: make mutations SAMPLE=300
mutations: install
	$(BIN)/python -m tests.mutations --sample $(or $(SAMPLE),300)

# Random scenarios and hostile files for a while: make fuzz MINUTES=20
fuzz: install
	$(BIN)/python -m tests.fuzz --minutes $(or $(MINUTES),10)

# Memory, descriptors and threads over many repetitions; CYCLES is a factor: make soak CYCLES=0.2
soak: install
	$(BIN)/python -m tests.soak --cycles $(or $(CYCLES),1)

# Memory of one long run without and with cameras: make soak-hour MINUTES=60
soak-hour: install
	$(BIN)/python -m tests.soak.hour --minutes $(or $(MINUTES),60)
	$(BIN)/python -m tests.soak.hour --minutes $(or $(MINUTES),60) --cameras

install: $(STAMP)

# The demo needs no extra but the video, and none of the developers' tools. Its run compiles what it imports: 5 s,
# where pip would compile all packages: 14 s.
$(DEMO_STAMP): pyproject.toml constraints.txt | system
	$(create_venv)
	$(PIP) --no-compile --editable '.[video]'
	@touch $@

$(STAMP): pyproject.toml constraints.txt | system
	$(create_venv)
	$(PIP) --editable '.[$(EXTRAS)]'
	@touch $(DEMO_STAMP) $@

define create_venv
@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	|| { echo "offtrack needs Python 3.11 or newer; found $$($(PYTHON) --version). Try: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 1; }
$(PYTHON) -m venv $(VENV)
endef

install-all: $(STAMP)-all

$(STAMP)-all: $(STAMP) | system-all
	$(PIP) --editable '.[$(TEST_EXTRAS)]'
	$(PIP) --no-deps gemseo-fmu
	@touch $@

# Cameras are rendered by Mesa on the CPU through EGL; installed only where something is missing.
system:
	@$(call install_missing,$(SYSTEM_PACKAGES),$(PYTHON) -c 'import ensurepip; import venv' 2>/dev/null || missing="$$missing python3-venv")

system-all:
	@$(call install_missing,$(TEST_PACKAGES),true)

# Debian packages that are missing: installed as root or by sudo, else named in one line.
define install_missing
missing=""; \
for package in $(1); do \
	dpkg-query -W -f='$${Status}' $$package 2>/dev/null | grep -q 'install ok installed' || missing="$$missing $$package"; \
done; \
$(2); \
if [ -n "$$missing" ]; then \
	echo "Installing system packages:$$missing"; \
	{ $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -qq -y -o Dpkg::Use-Pty=0 --no-install-recommends $$missing; } \
		|| { echo "Could not install system packages; as root: apt-get install$$missing"; exit 1; }; \
fi
endef

clean:
	rm -rf $(VENV)
