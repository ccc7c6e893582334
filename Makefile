# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
#
# make demo                      planes on real pictures, through the real node -> demo_output/
# make demo IMAGES=folder FX=..  the same on your own (FX FY CX CY in pixels, or FOV in degrees)
# make test                      the tests
# make lint                      ruff
# make faults                    faults on purpose, as a table; SOAK_MINUTES=20 adds a long run
# make benchmark                 the tables of docs/results.md (ARGS='segmentation --only rooms')
# make lock                      .ci/requirements.lock, the hashes of all packages (needs uv)
# make defaults                  config/plane_detector.yaml and docs/parameters.md from config.py
#
# ROS need not be installed: it comes as wheels into .venv, made on first use by the python3
# on the path, or the one that PYTHON=... names.

VENV ?= .venv
PYTHON ?=
RUN := $(VENV)/bin/python
STAMP := $(VENV)/installed

# A sourced ROS or another environment of ROS wheels must not leak into this one.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH RMW_IMPLEMENTATION
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

.PHONY: demo test lint faults benchmark defaults lock clean
.DEFAULT_GOAL := demo

demo: $(STAMP)
	@$(RUN) -m plane_detector.tools.demo \
	    $(foreach name,IMAGES FX FY CX CY FOV MODEL OUTPUT,$(call option,$(name)))

test: $(STAMP)
	@$(RUN) -m pytest $(TESTS)

lint: $(STAMP)
	@$(RUN) -m ruff check .

faults: $(STAMP)
	@PYTHONPATH=.:test/helpers $(RUN) test/faults/run.py $(ARGS) \
	    $(if $(SOAK_MINUTES),--soak-minutes $(SOAK_MINUTES))

benchmark: $(STAMP)
	@$(RUN) -m plane_detector.evaluation.benchmark $(or $(ARGS),accuracy)

defaults: $(STAMP)
	@$(RUN) -m plane_detector.tools.defaults --write

lock:
	@.ci/lock

clean:
	rm -rf $(VENV) demo_output benchmark_output

# --fx 525 when FX=525 is given to make, nothing otherwise: an OUTPUT of the shell is not ours.
option = $(if $(filter command%,$(origin $1)),--$(shell echo $1 | tr A-Z a-z) '$($1)')

$(STAMP): .ci/requirements.lock
	@bash .ci/make_venv '$(VENV)' '$(PYTHON)'
	@touch $@
