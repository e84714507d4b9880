# make run    sees speech move a head, here and in a browser; installs what it needs into .venv first
# make quick  in a minute: the tests that most changes break first
# make test   the tests
# make traces the motion that tests/lipservo/traces/test_reference_traces.py holds, anew: docs/traces.md
# make docs   a site of all pages with search, and the reference of all public names, into site/
# make check  style, types, the docs, slow tests, and the wheels: what they hold, and that they run alone
# make agents the adapters with the real packages (Pipecat, LiveKit, Wyoming, OpenAI: 1 GB), in .venv-agents
# make mutants  400 mutants of the lines that a stop depends on, each against the nearest tests: within an hour
# make campaign  every campaign whole, and slow tests of the lab: two hours
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

PYTEST := $(BIN)/python -m pytest
# Those of benches and of training, a quarter of them, run with the campaigns: no robot has the lab.
SLOW := -m "slow and not campaign" --ignore tests/lab
PACKAGING := -m packaging tests/examples tests/project
# Tests of processes share the processors with each other. What failed is tried once more alone, and
# the log shows both: docs/decisions/tests-and-mutants.md.
once_more_alone = || { [ $$? = 1 ] && echo "=== what failed beside others, once more alone ===" \
	&& $(PYTEST) --last-failed --last-failed-no-failures none $(1); }

.PHONY: run quick test traces docs check agents campaign mutants format clean

# Heard where `lipservo devices` finds a loudspeaker; silent where there is none.
run: $(VENV)/.installed
	@echo "A page opens: type a sentence at its top, or let an example be said. Ctrl-C here ends it."
	@echo "Next: docs/hardware.md for servos, docs/agents.md for a voice agent, docs/simulator.md for tests."
	$(BIN)/lipservo run --config face_head --dashboard --open $$($(BIN)/lipservo devices 2>/dev/null | grep -qx loudspeakers && echo --play)

QUICK := $(addprefix tests/,$(addprefix firmware_bridge/,gate process serial_servos loop/test_bridge.py) \
	calibration/files lipsync/phoneme_files \
	$(addprefix lipservo/,rendering settings terminal))
quick: $(VENV)/.installed-dev
	$(PYTEST) --quiet --numprocesses auto --dist loadfile $(QUICK)

# Half of what the tests of processes do is waiting: two workers a core.
test: $(VENV)/.installed-dev
	$(PYTEST) --numprocesses $$((2 * $$(getconf _NPROCESSORS_ONLN))) --dist loadfile --no-loadscope-reorder --durations 15 $(call once_more_alone)

traces: $(VENV)/.installed-dev
	$(BIN)/python tests/support/make_reference_traces.py

# These modules need torch, pipecat, livekit or wyoming, which .venv does not have: docs/decisions/release-and-site.md.
UNDOCUMENTED := $(addprefix lipservo_client.,pipecat_face livekit_face wyoming_face) \
	$(addprefix lipservo_lab.bench.agents.,pipecat_agent livekit_agent openai_agent wyoming_agent day_agent) \
	lipservo_lab.learning.adaptation.voice_learning \
	$(addprefix lipservo_lab.learning.recognition.,network_training torch_network training_run)
SITE := site
PAGES := build/pages
export NO_MKDOCS_2_WARNING := 1
docs: $(VENV)/.installed-docs
	rm -rf $(SITE) $(PAGES)
	$(BIN)/python docs/site_pages.py $(PAGES)
	$(BIN)/python -W error $(foreach module,$(UNDOCUMENTED),-W "ignore:Couldn't import $(module)") \
		-m pdoc --docformat markdown --no-show-source --output-directory $(PAGES)/api \
		calibration firmware_bridge lipservo lipservo_client lipservo_lab lipsync $(foreach module,$(UNDOCUMENTED),'!$(subst .,\.,$(module))$$')
	PAGES=$(abspath $(PAGES)) $(BIN)/python -m mkdocs build --strict --quiet --site-dir $(abspath $(SITE))
	@echo "python -m http.server -d $(SITE) serves it"

check: $(VENV)/.installed-dev $(VENV)/.installed-docs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	rm -rf dist build
	$(BIN)/python -m build --wheel --outdir dist . >/dev/null
	$(BIN)/check-wheel-contents dist
	$(PYTEST) --numprocesses 2 --dist loadfile --durations 15 $(PACKAGING) $(call once_more_alone,$(PACKAGING))
	$(PYTEST) --numprocesses 2 --dist loadfile --durations 15 $(SLOW) $(call once_more_alone,$(SLOW))

# An import that fails would be a skipped test, so they are imported first.
AGENTS := .venv-agents
agents: $(AGENTS)/.installed
	$(AGENTS)/bin/python -W ignore -c "import livekit.agents, openai.types.realtime, pipecat.pipeline.worker, wyoming.snd" 2>&1
	$(AGENTS)/bin/python -m pytest --durations 5 -m "not campaign" tests/client tests/examples/test_realtime_sdk.py tests/lab/bench/agents

campaign: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --timeout 0 --durations 15 -m campaign
	$(PYTEST) --durations 15 -m "slow and not campaign" tests/lab
	$(BIN)/lipservo bench faults
	$(BIN)/lipservo bench faults --stops
	$(BIN)/lipservo bench faults --signals
	$(BIN)/lipservo bench endurance

mutants: $(VENV)/.installed-mutants
	$(BIN)/python tests/support/mutants/mutants.py

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) $(AGENTS) dist build site *.egg-info client/*.egg-info lab/*.egg-info client/build lab/build .pytest_cache .mypy_cache .ruff_cache

$(VENV)/.installed: pyproject.toml client/pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dashboard,fit,say]' --editable ./client
	touch $@

$(VENV)/.installed-dev: pyproject.toml client/pyproject.toml lab/pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]' --editable ./client --editable ./lab
	touch $(VENV)/.installed $@

# Not in `dev`: its newest packages want a newer Python than Debian 12 has.
$(VENV)/.installed-docs: $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

# Not in `dev`: `make test` needs none of its thirty packages.
$(VENV)/.installed-mutants: $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[mutants]'
	touch $@

# The client first: pip does not find it for the others once it has extras.
$(AGENTS)/.installed: pyproject.toml client/pyproject.toml lab/pyproject.toml
	$(PYTHON) -m venv $(AGENTS)
	$(AGENTS)/bin/python -m pip install --quiet --disable-pip-version-check --editable './client[pipecat,livekit,wyoming]' \
		--editable . --editable ./lab openai hypothesis pytest pytest-timeout
	touch $@
