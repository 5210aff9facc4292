# Needs python3 (3.11 or newer, with venv) and make; everything else goes into .venv. Options for a command: ARGS="..."
PYTHON := python3
VENV := .venv
BIN := $(VENV)/bin
ARGS :=
TEST_BUDGET_S := 1800
WITHIN_BUDGET = $(shell command -v timeout >/dev/null && echo timeout --foreground --signal=INT --kill-after=60 $(TEST_BUDGET_S))
BY_THE_CLOCK := tests/services/runs/test_link_delay.py tests/services/runs/test_real_time_run.py
PAGE := tests/services/web/page
PAGE_BY_THE_CLOCK := $(PAGE)/test_speed.py
# One more than there are processors, for the tests often wait: for a lease to end, for a process to start.
WORKERS = $(shell $(PYTHON) -c "import os; print(len(os.sched_getaffinity(0)) + 1)")
RESULTS := build/paper
COMMA := ,
RUN_STORE := build/run.db
LITERAL_RUNS := 30
# Twice quiet: errors only, no warnings about the package sources that this machine is configured for.
PIP_INSTALL := $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check
INSTALL_PYTHON := install Python 3.11 or newer with venv (Debian, Ubuntu: apt install python3 python3-venv)

# Where an image sets this, every process would compile the sources of NumPy, SciPy and Numba that it imports, all of
# them again, and a run over Zenoh has seven processes: half of its processor time.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup docs run watch chaos test golden test-docker test-arm test-browser test-page test-page-speed screenshots node nightly lint format lock diagram paper beyond skies array reliability notice release sbom audit clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' Makefile

setup: $(VENV)/installed ## create .venv and install what requirements.lock says

# Another store: ARGS="--store FILE".
run: setup ## the main job: the paper's scenario over Zenoh, one process per role; kept in build/run.db
	@mkdir -p build
	@$(BIN)/cogradar run paper $(if $(findstring --connect,$(ARGS))$(COGRADAR_CONNECT),,--store $(RUN_STORE)) $(ARGS)

watch: setup ## aircraft that come and go, at 5 dwells a second, on a page until Ctrl-C; the store is build/watch.db
	@mkdir -p build
	@$(BIN)/cogradar run traffic --dwells unlimited --pace realtime --rate 5 --keep --store build/watch.db $(ARGS)

# An interrupt at the end of the budget, not a kill: the tests in flight still end the processes they started.
test: setup ## run every test, those by the clock with nothing beside them
	@$(WITHIN_BUDGET) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal $(if $(ARGS),$(ARGS),$(addprefix --ignore=,$(BY_THE_CLOCK)))
	@$(if $(ARGS),,$(WITHIN_BUDGET) $(BIN)/python -m pytest $(BY_THE_CLOCK))

# After a change that is meant to change a digest: ARGS=--write, and the commit says why.
golden: setup ## compare the digests of all shipped scenarios with services/bench/golden_digests.json
	$(BIN)/python -m tests.golden $(ARGS)

# Building the image may be silent for minutes, hence the longer fault time. The three hosts are tried beside the
# containers, with which they share nothing; the tests of one file share its services, and stay in one process.
test-docker: setup ## test the containers and three hosts; needs a Docker engine with Compose, and root for the hosts
	@docker info >/dev/null 2>&1 && docker compose version >/dev/null 2>&1 || \
		{ echo "make test-docker needs a Docker engine that answers and Docker Compose" >&2; exit 1; }
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "(docker or netns) and not nightly" -o faulthandler_timeout=900 $(ARGS) tests/containers

# Five minutes. The first time half an hour more, to install and to compile kernels under QEMU: machines stay in /var/tmp.
test-arm: setup ## test ARM64 and a Haswell under QEMU, alone and beside this one; needs root, debootstrap and qemu-user-static
	tests/arm/machine.sh arm64
	tests/arm/machine.sh amd64
	$(BIN)/python -m pytest -m arm -o faulthandler_timeout=3600 $(ARGS) tests/arm

# The tests of one file share its runs, and stay in one process; those by the clock have nothing beside them.
test-browser: test-page $(if $(ARGS),,test-page-speed) ## test the page; needs Chromium (Debian: apt install chromium-headless-shell, or chromium)

test-page: setup ## test the page, but for how fast it is
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m "browser and not nightly" --ignore=$(PAGE_BY_THE_CLOCK) $(ARGS) $(if $(findstring tests/,$(ARGS)),,$(PAGE))

test-page-speed: setup ## ... and how fast it is, with nothing beside it
	$(BIN)/python -m pytest -m "browser and not nightly" $(ARGS) $(PAGE_BY_THE_CLOCK)

# AsyncAPI's own parser, MessagePack in JavaScript, and axe for the page. Without them their tests are skipped.
node: ## what some tests run in Node; needs npm
	npm ci --prefix tests/node --ignore-scripts --no-audit --no-fund

screenshots: setup ## draw docs/figures/page-* (pictures, and ten seconds with a planner killed) from a run of the paper's scenario; needs Chromium
	$(BIN)/python -m pytest -m screenshots -o faulthandler_timeout=900 $(ARGS) tests/services/web/page

# An interrupted simulation goes on where it was. After a change of the program: SIMULATED=build/new.json
SIMULATED := build/simulated.json
nightly: setup ## what takes too long for every change: the nightly tests, make chaos, a million simulated schedules
	$(BIN)/mypy --platform darwin --cache-dir .mypy_cache/darwin cogradar
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 cogradar
	$(BIN)/python -m pytest -m "nightly and not (docker or netns)" -o faulthandler_timeout=3600 $(ARGS)
	docker info >/dev/null && $(BIN)/python -m pytest -m "nightly and (docker or netns)" tests/containers
	$(MAKE) chaos
	@mkdir -p $(dir $(SIMULATED))
	$(BIN)/cogradar simulate --schedules 1000000 --store $(SIMULATED)

# Types as on macOS and Windows are checked at night: each check takes a minute of processor time. Tests and studies are
# for Linux alone: they stop processes by signals, and read what they used.
lint: setup ## style, types, import rules, and what is published for other languages
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/codespell
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(BIN)/python -m tests.contract

docs: setup ## the documentation site, into build/site; a warning is an error
	$(BIN)/python -m sphinx -b html --fail-on-warning --quiet --jobs auto docs build/site
	@echo "build/site/index.html"

format: setup ## bring the sources into shape
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

lock: ## bring requirements.lock up to pyproject.toml (newest versions: ARGS=--upgrade)
	$(BIN)/uv pip compile pyproject.toml --quiet --universal --python-version 3.11 --extra dev --generate-hashes \
		--no-emit-index-url --no-emit-find-links --no-header --no-annotate --output-file requirements.lock $(ARGS)

# An interrupted campaign goes on where it was. After a change of the program: make paper RESULTS=build/new
# LITERAL_RUNS: a run to the letter costs five times as much, nearly all of it random rollouts.
paper: setup ## the paper's tables and figures: to the letter, robust and best, into docs/results.md, docs/figures
	@mkdir -p $(dir $(RESULTS))
	$(BIN)/cogradar campaign paper --runs 100 --store $(RESULTS).db --resume $(ARGS)
	$(BIN)/cogradar campaign paper-literal --runs $(LITERAL_RUNS) --strategies uniform,power-aware \
		--store $(RESULTS)-literal.db --resume $(ARGS)
	$(BIN)/cogradar campaign paper-best --runs 100 --strategies power-aware --store $(RESULTS)-best.db --resume $(ARGS)
	$(BIN)/cogradar report $(RESULTS)-literal.db $(RESULTS).db $(RESULTS)-best.db --into docs/results.md
	$(BIN)/python -m docs.generator.readme
	$(BIN)/cogradar figures $(RESULTS).db --out docs/figures

# What each part buys beyond the paper; a sweep's store is named like the markers of its tables. After a change of the
# program: make beyond BEYOND=build/new
BEYOND := build/beyond
SWEEP = @mkdir -p $(BEYOND) && $(BIN)/cogradar sweep $(2) --runs $(3) --strategies $(4) --store $(BEYOND)/$(1).db \
	--resume --into docs/beyond.md --out $(BEYOND)/$(1) $(ARGS)
beyond: setup ## what steered beams, joint looks, range cells, urgency and wide looks buy, into docs/beyond.md
	$(call SWEEP,looks,paper --over radar.planner.looks=single$(COMMA)joint,100,power-aware)
	$(call SWEEP,published,paper-literal --over radar.planner.looks=single$(COMMA)joint,100,power-aware)
	$(call SWEEP,fidelity,paper --over radar.fidelity=best$(COMMA)best-range,100,power-aware)
	$(call SWEEP,rcs,paper-best-range --over world.rcs=swerling1$(COMMA)swerling3,100,power-aware)
	$(call SWEEP,starved,starved --over radar.allocation.objective=max-min$(COMMA)urgency,100,power-aware)
	$(call SWEEP,turn,turn --over radar.planner.looks=single$(COMMA)joint,100,orthogonal$(COMMA)power-aware)
	$(call SWEEP,particles,paper-best --over radar.belief.n_particle=12000$(COMMA)1000000,10,power-aware)

# Some two hours; an interrupted sweep goes on where it was. After a change of the program: make skies SKIES=build/new
SKIES := build/skies
SKY = @mkdir -p $(SKIES) && $(BIN)/cogradar sweep $(2) --runs $(3) --strategies $(4) --store $(SKIES)/$(1).db \
	--resume --into docs/skies.md --out $(SKIES)/$(1) $(ARGS)
# The aircraft over Paris of ten minutes, from the sample data of the package `traffic`.
$(SKIES)/paris.toml: studies/recorded.py | setup
	@mkdir -p $(SKIES)
	$(BIN)/python -m studies recorded quickstart --begin 1633609201 --end 1633609801 --out $(SKIES)/paris.csv
	$(BIN)/cogradar sky --from $(SKIES)/paris.csv --origin 48.35,2.4 --boresight 0 --out $@ --force

skies: setup $(SKIES)/paris.toml ## unknown numbers of aircraft: recorded, made up, crossing, turning, none; into docs/skies.md
	$(call SKY,recorded,$(SKIES)/paris.toml --over radar.fidelity=best-range --dwells 200,5,power-aware)
	$(BIN)/cogradar run $(SKIES)/paris.toml --in-process --dwells 200 --set radar.fidelity=best-range --store $(SKIES)/life.db
	$(BIN)/cogradar figures $(SKIES)/life.db --out $(SKIES)/life && cp $(SKIES)/life/life.png docs/figures
	$(call SKY,traffic,traffic --over radar.search.beams=10,20,orthogonal$(COMMA)power-aware)
	$(call SKY,crossing,crossing --over radar.fidelity=best-range,200,power-aware)
	$(call SKY,meeting,meeting --over radar.fidelity=best-range,200,power-aware)
	$(call SKY,hard-turns,hard-turns --over radar.motion.modes=constant-velocity$(COMMA)mixture,30,power-aware)
	$(call SKY,nobody,nobody --over radar.initiation.false_tracks_per_hour=20$(COMMA)1 --dwells 10000,4,power-aware)
	$(call SKY,unannounced,paper-best-range --over 'radar.tracks=3$(COMMA)"unknown"',100,power-aware)
	$(MAKE) -C studies trackers

# Some hours; an interrupted sweep goes on where it was. After a change of the program: make array ARRAY=build/new
# Of the seeds 1 to 120, that of `twelve` has an aircraft closest to 10 km and the fewest within 1.5 main lobes of each other;
# `crowded` has the most of the seeds 1 to 40.
ARRAY := build/array
WORLD = @mkdir -p $(ARRAY) && $(BIN)/cogradar sweep $(2) --runs $(3) --strategies power-aware --store $(ARRAY)/$(1).db \
	--resume --into docs/array.md --out $(ARRAY)/$(1) $(ARGS)
IN_ARRAY := --set world.signal=array
NO_RANGE := --set radar.fidelity=best --dwells 50
TURNED := --set 'world.targets.3.state=[20.5, 0.05, 56.6, 0.01]'
JAMMER := [{bearing_deg = 38.6, jnr_db = 20.0}]
$(ARRAY)/twelve.toml: | setup
	@mkdir -p $(ARRAY)
	$(BIN)/cogradar sky --aircraft 12 --minutes 1 --seed 109 --out $@ --force

$(ARRAY)/crowded.toml: | setup
	@mkdir -p $(ARRAY)
	$(BIN)/cogradar sky --aircraft 12 --minutes 1 --seed 38 --out $@ --force

# Twelve others, all at 10 km.
$(ARRAY)/high.toml: | setup
	@mkdir -p $(ARRAY)
	$(BIN)/cogradar sky --aircraft 12 --minutes 1 --seed 25 --out $(ARRAY)/low.toml --force
	awk '/^state/ { print "height_km = 10.0" } { print }' $(ARRAY)/low.toml >$@

array: setup $(ARRAY)/twelve.toml $(ARRAY)/crowded.toml $(ARRAY)/high.toml ## the radar in the world of an array, into docs/array.md, docs/figures
	$(BIN)/python -m studies.array antennas --into docs/array.md
	$(BIN)/python -m studies.array blind --into docs/array.md
	$(BIN)/python -m studies.array noise --recording $(ARRAY)/sea.npy --into docs/array.md
	$(call WORLD,steered,paper-best $(IN_ARRAY) $(TURNED) --over radar.receiver.separation=joint,100)
	$(call WORLD,twelve,$(ARRAY)/twelve.toml $(IN_ARRAY) $(NO_RANGE) --over radar.receiver.separation=none$(COMMA)joint,20)
	$(call WORLD,crowded,$(ARRAY)/crowded.toml --set name=twelve $(IN_ARRAY) $(NO_RANGE) --over radar.receiver.separation=none$(COMMA)joint,10)
	$(call WORLD,traffic,traffic $(IN_ARRAY) --over radar.receiver.separation=none$(COMMA)joint --dwells 300,10)
	$(call WORLD,jammer,paper-best $(IN_ARRAY) $(TURNED) --set radar.receiver.noise=rows --over 'world.jammers=[]$(COMMA)$(JAMMER)' --dwells 60,2)
	$(call WORLD,heights,$(ARRAY)/high.toml $(IN_ARRAY) --over radar.assumes.height_max_km=0$(COMMA)12 --dwells 40,10)
	$(BIN)/python -m studies.array heights $(ARRAY)/heights.db --into docs/array.md
	$(call WORLD,best,paper-best --over world.signal=cells$(COMMA)array,20)
	$(call WORLD,literal,paper-literal --over world.signal=cells$(COMMA)array,1)
	$(BIN)/python -m studies.array worlds $(ARRAY)/best.db --out docs/figures/array-best
	$(BIN)/python -m studies.array worlds $(ARRAY)/literal.db --out docs/figures/array-literal

chaos: setup ## 20 runs whose processes are killed at random; their digests must be those of runs left in peace
	$(BIN)/cogradar chaos $(ARGS)

reliability: setup ## play what holds each promise of docs/reliability.md, and write the results there; some hours
	PATH="$(CURDIR)/$(BIN):$$PATH" python -m docs.generator.reliability $(ARGS)


# What `docker build` puts into the image beside Python: what pyproject.toml asks for, of the lock.
build/image.txt: requirements.lock pyproject.toml | setup
	@mkdir -p build
	@$(BIN)/uv pip compile --quiet --no-header --no-annotate --extra postgres --constraint requirements.lock pyproject.toml --output-file build/wanted.txt
	@$(BIN)/python deploy/container/dependencies.py requirements.lock build/wanted.txt >$@

# The versions of requirements.lock, the licences that the packages state.
notice: setup ## list the libraries that cogradar needs at run time, with their licences, in NOTICE
	$(BIN)/python -m docs.generator.notice

# What a user gets: both files are checked, and each is installed into an empty environment, with what the lock says, in
# which the first run is played. Kernels compile there as they would for a user.
release: build/image.txt ## build wheel and source distribution into build/dist, check, install and try each
	rm -rf build/dist build/release
	$(BIN)/uv build --quiet --no-build-isolation --out-dir build/dist
	$(BIN)/twine check --strict build/dist/*
	for file in build/dist/*; do PYTHON=$(BIN)/python deploy/release/try.sh $$file build/image.txt || exit 1; done

sbom: build/image.txt ## what is in the image, as CycloneDX, into build/sbom.json
	@PYTHONWARNINGS=ignore $(BIN)/cyclonedx-py requirements --pyproject pyproject.toml --output-reproducible --output-file build/sbom.json $<
	@echo build/sbom.json

# --strict: what could not be looked up is a fault and no pass.
audit: build/image.txt ## known vulnerabilities of what is in the image; asks a database on the net
	$(BIN)/pip-audit --vulnerability-service osv --strict --disable-pip --require-hashes --requirement $<

diagram: setup ## redraw the loop in ARCHITECTURE and docs/reference/wire.md from the table of topics
	$(BIN)/python -m docs.generator.loop_diagram ARCHITECTURE.md docs/reference/wire.md

clean: ## remove .venv, caches and build leftovers
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find services shared tests -name __pycache__ -type d -prune -exec rm -rf {} +

# pip is the last thing that venv puts in place, so half an environment is made again.
$(BIN)/pip:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: $(INSTALL_PYTHON)" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "$(PYTHON) is $$($(PYTHON) -V 2>&1 | head -n 1): $(INSTALL_PYTHON), or say which: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "$(PYTHON) has no venv or no ensurepip: $(INSTALL_PYTHON)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# The copy says what is installed: no index is asked again until the lock's text changes, whatever its date.
# The lock is complete, so that nothing is resolved: of `traffic` the files alone are wanted (pyproject.toml).
# uv takes a quarter of a minute where pip takes two; pip installs what uv cannot find with its own configuration.
$(VENV)/requirements.lock: requirements.lock | $(BIN)/pip
	@cmp -s $< $@ || { echo "installing the packages of $< into $(VENV) (half a minute, or two) ..." && \
		awk '/^[^ ]/ { chosen = /^uv==/ } chosen' $< >$(VENV)/uv.lock && $(PIP_INSTALL) --require-hashes -r $(VENV)/uv.lock && \
		{ $(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --require-hashes -r $< || $(PIP_INSTALL) --no-compile --no-deps --require-hashes -r $<; }; }
	@cp $< $@

$(VENV)/installed: pyproject.toml $(VENV)/requirements.lock
	@PYTHONWARNINGS="ignore:Editable installation" $(PIP_INSTALL) --no-deps --no-build-isolation --no-index -e .
	@touch $@
