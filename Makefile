# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
#
# make demo                      planes in photographs, through the real node -> demo_output/
# make demo IMAGES=folder FX=..  the same for your images (FX FY CX CY in pixels, or FOV in degrees;
#                                MOUNTING=upright: none was taken on its side or straight down)
# make test                      the tests
# make lint                      ruff, codespell
# make faults                    fault injection, results as a table; SOAK_MINUTES=20 adds a long run
# make benchmark                 the tables of docs/results.md (ARGS='labelled --frames')
# make scores                    one table of every front, against its floors (ARGS='--only colour')
# make lock                      .ci/requirements.lock, the hashes of all packages (needs uv)
# make defaults                  config/plane_detector.yaml and docs/parameters.md from config.py
#
# ROS need not be installed: its wheels are installed into .venv, which is created on first use
# with the python3 on the path, or with the one given by PYTHON=...

VENV ?= .venv
PYTHON ?=
RUN := $(VENV)/bin/python
# The environment in which the core is tested, which needs no ROS.
CORE ?= $(VENV)
STAMP := $(VENV)/installed

# Variables of a sourced ROS, or of another environment with ROS wheels, would break this one.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH RMW_IMPLEMENTATION
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

.PHONY: demo test lint faults benchmark scores defaults lock clean
.DEFAULT_GOAL := demo

demo: $(STAMP)
	@$(RUN) -m plane_detector.tools.demo \
	    $(foreach name,IMAGES FX FY CX CY FOV MOUNTING MODEL OUTPUT,$(call option,$(name)))

# In two processes, which take six minutes on two cores; with TESTS=... only these, in one.
test: $(STAMP)
ifdef TESTS
	@$(RUN) -m pytest $(TESTS)
else
	@log=$$(mktemp); $(CORE)/bin/python -m pytest test --ignore=test/ros --ignore=test/tools > $$log 2>&1 & core=$$!; \
	$(RUN) -m pytest test/ros test/tools; code=$$?; \
	wait $$core || code=$$?; cat $$log; rm -f $$log; exit $$code
endif

lint: $(STAMP)
	@$(RUN) -m ruff check .
	@$(RUN) -m codespell_lib $(shell git ls-files "*.py" "*.md" "*.rst" "*.yaml" 2>/dev/null)

faults: $(STAMP)
	@PYTHONPATH=.:test/helpers $(RUN) test/faults/run.py $(ARGS) \
	    $(if $(SOAK_MINUTES),--soak-minutes $(SOAK_MINUTES))

benchmark: $(STAMP)
	@$(RUN) -m plane_detector.evaluation.benchmark $(or $(ARGS),accuracy)

scores: $(STAMP)
	@$(RUN) -m plane_detector.evaluation.scores $(ARGS)

defaults: $(STAMP)
	@$(RUN) -m plane_detector.evaluation.defaults

lock:
	@.ci/lock

clean:
	rm -rf $(VENV) demo_output benchmark_output

# --fx 525 if make was called with FX=525; a variable OUTPUT of the shell is ignored.
option = $(if $(filter command%,$(origin $1)),--$(shell echo $1 | tr A-Z a-z) '$($1)')

$(STAMP): .ci/requirements.lock
	@bash .ci/make_venv '$(VENV)' '$(PYTHON)'
	@touch $@
