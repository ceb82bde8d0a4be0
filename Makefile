# make demo | test | test-app | docs | extension | repository | artifacts | release | assets | lint | clean | clean-env
# (Linux, Python 3.11; sets everything up)
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.NOTPARALLEL:

PYTHON ?= $(shell for p in python3.11 /usr/bin/python3.11 /usr/local/bin/python3.11 python3; do \
  "$$p" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null && { echo "$$p"; break; }; done)
VENV := .venv/bin
PLATFORM ?=

.PHONY: help demo test test-app docs extension repository artifacts release assets lint python env-demo env-test env-matrix clean clean-env

help:
	@echo 'make demo       set up, build the demo scene, touch it: build/demo'
	@echo 'make test       set up, lint, types, all tests on bpy 5.0, 4.5 and 4.2'
	@echo 'make test-app   tests in a real, windowed Blender in a Debian chroot (root)'
	@echo 'make docs       the docs as a site, links checked: build/site'
	@echo 'make extension  the add-on as installable zips for every Blender since 4.2: dist; for one system'
	@echo '               alone: PLATFORM=linux-x64, windows-x64, macos-arm64 or macos-x64'
	@echo 'make repository an extension repository that Blender updates from: dist/repository'
	@echo 'make artifacts  wheels, zips, sums, bill of materials, installed once: dist/hnf-VERSION'
	@echo 'make release    make test, then make artifacts; docs/releasing.md'
	@echo 'make assets     the asset library that comes with the add-on: hnf_blender/assets'
	@echo 'make clean      delete build and dist;  make clean-env  delete the environments too'

python:
	@if [ -z '$(PYTHON)' ]; then \
	  echo 'Python 3.11 is needed and was not found. Install python3.11, or name it: make PYTHON=/path/to/python3.11' >&2; exit 1; fi

env-demo: python
	@'$(PYTHON)' tools/setup_env.py demo

env-test: python
	@'$(PYTHON)' tools/setup_env.py test

env-matrix: python
	@'$(PYTHON)' tools/setup_env.py test blender-5.2 blender-4.5 blender-4.2

demo: env-demo build/demo/demo.blend
	timeout 1800 $(VENV)/hnf touch build/demo/demo.blend --out build/demo

build/demo/demo.blend: tools/make_demo_scene.py $(wildcard tools/demo_scene/*.py) | env-demo
	@mkdir -p build/demo
	timeout 600 $(VENV)/python tools/make_demo_scene.py $@

test: env-matrix
	@$(VENV)/python tools/run_tests.py

test-app: env-test
	@$(VENV)/python tools/run_tests.py app

docs: python
	@[ -x .venv-docs/bin/mkdocs ] || { '$(PYTHON)' -m venv .venv-docs && .venv-docs/bin/python -m pip install -q -r tools/requirements/docs.txt; }
	NO_MKDOCS_2_WARNING=1 timeout 300 .venv-docs/bin/mkdocs build -q

lint: env-test
	$(VENV)/ruff check .
	$(VENV)/mypy

extension: env-demo
	$(VENV)/python tools/build_extension.py $(addprefix --platform ,$(PLATFORM))

repository: env-demo
	$(VENV)/python tools/build_repository.py

artifacts: env-demo
	$(VENV)/python tools/build_release.py
	$(VENV)/python tools/check_install.py dist/hnf-$$($(VENV)/hnf --version | cut -d ' ' -f 2)

# In this order: .NOTPARALLEL.
release: test artifacts

# With the oldest Blender: later ones read its files, it does not read theirs.
assets: env-matrix
	.venv-4.2/bin/python tools/build_assets.py

# --one-file-system: never follow a mount out of the tree (the chroot of test-app lies in build).
clean:
	rm -rf --one-file-system build dist

clean-env: clean
	rm -rf .venv .venv-5.2 .venv-4.5 .venv-4.2 .venv-docs hnf.egg-info tools/hnf_lab.egg-info
