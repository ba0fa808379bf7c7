# `make demo` and `make test` need nothing but a Debian or Ubuntu with Python 3.11 or newer.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
SYSTEM_PACKAGES := libegl1 libgl1 libgl1-mesa-dri

.PHONY: demo test install system lint benchmarks fuzz kills soak soak-hour clean

demo: install
	@rm -rf runs/demo
	$(BIN)/offtrack run roundabout --seed 1 --out runs/demo
	@echo "Open runs/demo/report.html"

test: install lint
	$(BIN)/pytest

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

benchmarks: install
	$(BIN)/pytest tests/benchmarks --override-ini addopts="--import-mode=importlib" --benchmark-only

# Commands killed at random moments and started again: make kills MOMENTS=40
kills: install
	$(BIN)/python -m tests.kills --moments $(or $(MOMENTS),40)
	$(BIN)/python -m tests.kills.engines

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

$(STAMP): pyproject.toml constraints.txt | system
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "offtrack needs Python 3.11 or newer; found $$($(PYTHON) --version). Try: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[video,tune,cad,fmi,roads,hil,cluster,sensitivity,dev]'
	@touch $@

# Cameras are rendered by Mesa on the CPU through EGL; installed only where something is missing.
system:
	@missing=""; \
	for package in $(SYSTEM_PACKAGES); do \
		dpkg-query -W -f='$${Status}' $$package 2>/dev/null | grep -q 'install ok installed' || missing="$$missing $$package"; \
	done; \
	$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || missing="$$missing python3-venv"; \
	if [ -n "$$missing" ]; then \
		echo "Installing system packages:$$missing"; \
		$(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -qq -y -o Dpkg::Use-Pty=0 --no-install-recommends $$missing; \
	fi

clean:
	rm -rf $(VENV)
