# make demo | test | test-slow | bench | lint | docs | clean: each sets up what it needs in .venv, with nothing but python3 and make.
#   make mutants           which single-line mutants of gates and thresholds the tests do not kill
#   make newest            some tests with the newest release of every dependency; make oldest: with the oldest allowed
#   make demo RIG=NAME     of another rig, by its name or path, into out/demo_NAME
#   make demo CAMERA=1     films the rig and closes the loop by a camera alone, into out/demo_camera
#   make demo BODY=native  closes the loop by estimator and controller as one process in C, into out/demo_native
#   make demo BODY=m7      closes the loop by a microcontroller in the emulator, into out/demo_m7 (docs: microcontrollers)
#   make demo TRAIN=1      trains the shipped policy afresh (adds torch)
#   make PYTHON=python3.12 another interpreter, where python3 is too old or too new; a .venv of another one is made anew
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
PACKAGE := pyproject.toml setup.py setup.cfg package.xml
TRAINED := $(filter-out 0,$(TRAIN))
FILMED := $(filter-out 0,$(CAMERA))
OUT := out/demo$(if $(FILMED),_camera)$(if $(BODY),_$(BODY))$(if $(RIG),_$(notdir $(RIG:/=)))
DEMO := $(if $(RIG)$(FILMED)$(BODY),$(BIN)/hybrid-sysid demo$(if $(FILMED), --camera)$(if $(BODY), --body $(BODY))$(if $(RIG), --rig $(RIG)),$(if $(HYBRID_SYSID_DATA),$(BIN)/python -m studies.beam_lecture demo $(HYBRID_SYSID_DATA),$(BIN)/hybrid-sysid demo)) --overwrite

# A sourced ROS, or the wheels of another environment, must not leak into .venv.
ifneq ($(ROS_DISTRO)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport AMENT_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
endif

.PHONY: demo test test-slow bench lint docs mutants newest oldest clean again
.NOTPARALLEL:

demo: .venv/ros $(if $(TRAINED),.venv/train) $(if $(FILMED),.venv/video)
	$(DEMO) --out $(OUT) $(if $(TRAINED),--train)

# Hundreds of processes of the tests import the package: its bytecode is kept, whatever the environment says.
test test-slow: export PYTHONDONTWRITEBYTECODE :=
# Several workers on few cores: threads of linear algebra that spin slow each other down.
test test-slow: export OMP_NUM_THREADS := 1

# One worker more than two cores: a fifth of the time tests wait for nodes and processes.
test: .venv/ros .venv/dev .venv/train
	$(BIN)/python -m pytest --numprocesses 3 --dist worksteal -m 'not slow'

test-slow: .venv/ros .venv/dev .venv/train
	$(BIN)/python -m pytest --numprocesses 2 --dist worksteal -m slow

bench: .venv/ros .venv/peers
	$(BIN)/python -m benchmarks

lint: .venv/dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy hybrid_sysid_ros studies benchmarks tests

docs: .venv/ros .venv/docs
	PLOTLY_RENDERER=notebook NO_MKDOCS_2_WARNING=1 DISABLE_MKDOCS_2_WARNING=true $(BIN)/mkdocs build --quiet
	@echo out/docs/index.html

mutants: .venv/ros .venv/dev .venv/mutants
	$(BIN)/python -m benchmarks.mutants

newest oldest: .venv/dev
	$(BIN)/python -m benchmarks.releases $@

clean: # out/ may hold recordings: it stays
	rm -rf .venv build install log *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: a set-up is repeated only when what it installs may have changed. torch is large, so it has its own.
ifneq ($(origin PYTHON),file)
.venv/python: $(if $(filter $(lastword $(shell $(PYTHON) --version 2>/dev/null)),$(lastword $(shell $(BIN)/python --version 2>/dev/null))),,again)
endif
.venv/python:
	$(if $(shell $(PYTHON) -c 'import sys; print((3, 10) <= sys.version_info[:2] <= (3, 13) or "")' 2>/dev/null),,$(error \
	hybrid_sysid_ros needs Python 3.10 to 3.13, but $(PYTHON) is $(or $(shell $(PYTHON) --version 2>/dev/null),missing): try make PYTHON=python3.12))
	$(PYTHON) -m venv --clear .venv
	@touch $@

.venv/ros: EXTRAS := ros,report,view
.venv/dev: EXTRAS := dev
.venv/train: EXTRAS := train
.venv/video: EXTRAS := video
.venv/docs: EXTRAS := docs
.venv/mutants: EXTRAS := mutants
.venv/peers: EXTRAS := peers,report,search
.venv/ros .venv/dev .venv/train .venv/video .venv/docs .venv/mutants .venv/peers: .venv/python $(PACKAGE)
	@echo "Setting up .venv: hybrid_sysid_ros[$(EXTRAS)]"
	@$(PIP) --editable '.[$(EXTRAS)]'
	@touch $@
