# Everything as an ordinary user: packages go to .venv, nothing else is touched.
# PYTHON=/path/to/python3 chooses the Python that a new .venv is made with.
.DEFAULT_GOAL := help
.ONESHELL:
.SHELLFLAGS := -ec
.PHONY: help setup demo test test-all docs fuzz soak bench reproduce clean

VENV := .venv
CANDIDATES := python3.12 python3.11 python3.13 python3.10 python3
STAMP := $(VENV)/.installed
PIP := $(VENV)/bin/python -m pip --disable-pip-version-check --quiet
# Neighbouring tests share problems, so each worker gets a run of them.
WORKERS := -n auto --dist worksteal
BENCHMARKS := $(filter-out benchmarks/_% benchmarks/animations.py benchmarks/black_box.py benchmarks/choosing.py benchmarks/crossed.py benchmarks/derivatives.py benchmarks/effects.py benchmarks/exports.py benchmarks/filters.py benchmarks/glowing_grid.py benchmarks/gpu.py benchmarks/pages.py benchmarks/pbdr.py benchmarks/reproduce.py benchmarks/settings.py benchmarks/shapes.py benchmarks/soak.py benchmarks/sooner.py benchmarks/steps_or_paths.py benchmarks/unseen.py benchmarks/volumes.py,$(sort $(wildcard benchmarks/*.py)))

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' Makefile

setup: $(STAMP) ## make .venv with pinned packages and .venv/bin/isas

demo: setup ## recover a pottery texture in about three minutes and write a report
	@$(VENV)/bin/isas run scene=pottery size=default budget.seconds=60

test: setup ## run the tests, a worker a core: about forty minutes on two
	@$(VENV)/bin/python -m pytest $(WORKERS)

test-all: setup ## run the slow tests as well, and compute all that tests compare with anew
	@ISAS_REFERENCES=live $(VENV)/bin/python -m pytest $(WORKERS) -m ''

docs: setup ## build the documentation site, build/docs/index.html
	@$(PIP) install -c constraints.txt --no-build-isolation -e '.[docs]'
	$(VENV)/bin/python -m sphinx -q -W --keep-going -c docs . build/docs
	echo build/docs/index.html

fuzz: setup ## read 100,000 damaged and hostile inputs
	@$(VENV)/bin/python tests/hard/fuzz.py

soak: setup ## run all kinds of problem for an hour, and watch memory and the time of a step
	@$(VENV)/bin/python benchmarks/soak.py

bench: setup ## run the measurements under benchmarks/, one after the other
	@for script in $(BENCHMARKS); do
		echo "$$script"
		$(VENV)/bin/python "$$script"
	done

reproduce: setup ## race the samplers on every scene of the paper: hours; SCENES="pottery bowl" for some, LAUNCHER=ray for a cluster
	@$(VENV)/bin/python benchmarks/reproduce.py $(SCENES) $(if $(LAUNCHER),--launcher $(LAUNCHER))

clean: ## remove .venv, build outputs and caches; runs/ stays
	@rm -rf $(VENV) build dist *.egg-info .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Must run on any Python, also on 2: a reason to refuse it, or "ok".
define PROBE
import sys
version = "%d.%d" % sys.version_info[:2]
if not (3, 10) <= sys.version_info[:2] <= (3, 13):
    print("isas needs Python 3.10 to 3.13 and found %s: install one, on Debian 12, Ubuntu 22.04"
          " and newer with: sudo apt install python3 python3-venv" % version)
else:
    try:
        import ensurepip, venv
        print("ok")
    except ImportError:
        print("Python %s lacks the venv module: sudo apt install python3-venv or python%s-venv"
              % (version, version))
endef
export PROBE

# A .venv holds absolute paths, so one that was moved or copied here counts as not installed.
ifneq ($(shell cat $(STAMP) 2>/dev/null),$(CURDIR))
.PHONY: $(STAMP)
endif

# Candidates are tried by running them: a version manager's stand-ins exist but may fail. The
# stamp comes last, so an interrupted installation is taken up again.
$(STAMP): pyproject.toml constraints.txt
	@python= ; reason=
	for candidate in $(if $(PYTHON),"$(PYTHON)",$(CANDIDATES)); do
		answer=$$("$$candidate" -c "$$PROBE" 2>/dev/null) || continue
		if [ "$$answer" = ok ]; then python=$$candidate; break; fi
		case "$$reason" in *"lacks the venv"*) ;; *) reason=$$answer ;; esac
	done
	if [ -z "$$python" ]; then
		found="$(if $(PYTHON),PYTHON=$(PYTHON) does not run,no Python 3 was found)"
		echo "$${reason:-$$found: sudo apt install python3 python3-venv}" >&2
		exit 1
	fi
	if ! $(VENV)/bin/pip --version 2>/dev/null | grep -qF " from $(CURDIR)/$(VENV)/"; then
		rm -rf $(VENV)
		"$$python" -m venv $(VENV) || { rm -rf $(VENV); exit 1; }
	fi
	echo "installing packages into $(VENV) (about 300 MB to download, a few minutes)"
	$(PIP) install -c constraints.txt setuptools wheel
	$(PIP) install -c constraints.txt --no-build-isolation -e '.[test]'
	echo "$(CURDIR)" > $(STAMP)
