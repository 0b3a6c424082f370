# Everything a fresh machine needs, and the commands people type.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEMO := out/demo
SYSTEM_LIBRARIES := libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6

DEMO_SETTINGS := --set verify.front_deg=180 --set texture.held_out=2 --set export.voxels=voxels \
	--set export.voxel_resolution=512 --set export.surfels=30000 --set export.cells=context \
	--set export.cell_resolution=512 --set 'export.clouds=["copc","potree"]'
# The page is measured where there is a browser to open it in.
MEASURED := $(if $(shell command -v chromium chromium-browser google-chrome),--measure)

.PHONY: demo test test-full fuzz faults lint types imports check setup readme clean

demo: setup
	rm -rf $(DEMO)
	$(BIN)/workbench simulate $(DEMO) --scene statue --seed 7 --size small --photos 24
	# Masks that a user would draw by hand: of one scan and one photograph.
	mkdir -p $(DEMO)/masks/training
	cp $(DEMO)/truth/masks/scan_00.png $(DEMO)/truth/photos/object/photo_000.png $(DEMO)/masks/training
	$(BIN)/workbench stability $(DEMO) --quick
	$(BIN)/workbench run $(DEMO) --to export $(DEMO_SETTINGS)
	$(BIN)/workbench publish $(DEMO) --out out/site --resolution 512 --steps 12 $(MEASURED)
	$(BIN)/workbench sweep $(DEMO) --quick --repeats 1 $(DEMO_SETTINGS)
	$(BIN)/workbench run $(DEMO) $(DEMO_SETTINGS)
	@echo "The report is in $(CURDIR)/$(DEMO)/report/report.html"
	@echo "The model: $(BIN)/workbench view $(DEMO), or any web server in $(CURDIR)/out/site"

# Tests run in two processes; a process that runs out of its share takes over from the other.
PROCESSES ?= 2
PYTEST := $(BIN)/python -m pytest -q --numprocesses $(PROCESSES) --dist worksteal

test: check
	$(PYTEST) -m "not slow"

test-full: check
	$(PYTEST) -o faulthandler_timeout=3600

# Readers against damaged files: all of them, or make fuzz READER="ply ptx" EXECUTIONS=1000000.
# ENGINE=atheris is guided by coverage; it takes pip install --editable '.[fuzz]'.
EXECUTIONS ?= 20000
READER ?=
ENGINE ?= own
fuzz: setup
	$(BIN)/python -m tests.fuzz.run --executions $(EXECUTIONS) --engine $(ENGINE) \
		$(foreach reader,$(READER),--reader $(reader))

# Runs killed at random moments, full disks, damaged files and more, on a small project of its
# own; PROJECT=out/demo shows the table in another project's report, too.
KILLS ?= 100
PROJECT ?=
faults: setup
	$(BIN)/python -m tests.faults.run --kills $(KILLS) --worker-kills $$(($(KILLS) / 20)) \
		$(if $(PROJECT),--project $(PROJECT))

check: lint types imports

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

imports: setup
	$(BIN)/lint-imports

# The tables of stages and options in the README are made from the code.
readme: setup
	$(BIN)/workbench options --readme README.md > /dev/null

setup: $(READY)

$(READY): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@$(BIN)/python -c "import open3d, pymeshlab" 2>/dev/null || $(MAKE) --no-print-directory system
	touch $@

# Open3D and PyMeshLab need libraries a bare machine lacks: installed where that is allowed,
# else the one line to type is said.
.PHONY: system
system:
	@if [ "$$(id -u)" = 0 ]; then apt-get update -q && apt-get install -y -q --no-install-recommends $(SYSTEM_LIBRARIES); \
	elif sudo -n true 2>/dev/null; then sudo apt-get update -q && sudo apt-get install -y -q --no-install-recommends $(SYSTEM_LIBRARIES); \
	else echo "Type this, then make again:  sudo apt-get install -y $(SYSTEM_LIBRARIES)"; exit 3; fi

clean:
	rm -rf $(VENV) out
