# Targets only dispatch to `msv2`; every command has --help. Variables become options of the same name.
PYTHON ?= python3
RUN := .venv/bin/python
MSV2 := $(RUN) -m msv2
TESTS := $(RUN) -m pytest -n auto --dist worksteal
EXTRAS ?=

# A misspelt variable would otherwise be ignored: those of the command line are checked against what the targets use.
given := $(foreach name,$(.VARIABLES),$(if $(filter command,$(firstword $(origin $(name)))),$(name)))
ifneq ($(filter-out MAKEFLAGS SHELL -%,$(given)),)
complaint := $(shell $(PYTHON) msv2/cli/make_variables.py $(MAKECMDGOALS) -- $(filter-out MAKEFLAGS SHELL -%,$(given)))
ifneq ($(complaint),)
$(error $(complaint))
endif
endif

option = $(if $($(1)),--$(2) "$($(1))")
switch = $(if $(filter-out 0,$($(1))),--$(2))
request = $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,CAMERA,camera) $(call option,ORBIT,orbit) $(standpoint) $(call option,GAZE,gaze) \
	$(call option,LEVELS,levels) $(call option,LEVELS_FROM,levels-from) $(call option,LOD,lod) $(call option,BACKGROUND,background) $(call option,SEED,seed) $(call option,OUT,out)
standpoint = $(call option,UP,up) $(call option,LOOK_AT,look-at) $(call option,FOV,fov)
effects = $(call option,EFFECTS,effects) $(call switch,DEPTH,depth)
eyes = $(call switch,STEREO,stereo) $(call option,ECC,ecc-thresh) $(call option,IPD,ipd) \
	$(call option,UNITS_PER_METRE,units-per-metre) $(call option,SOURCE,source) $(call option,GAZE_RIGHT,gaze-right)
config = $(call option,CONFIG,config) $(foreach value,$(SET),--set "$(value)")

.DEFAULT_GOAL := help
.PHONY: help setup base tested documented viewable view demo render look frame video sim synth fpga mappable verilog report-area report-energy report-performance report perf study sweep train tables-training table-ecc table-effects tradeoff bench results stability docs doctor check test test-long lint

help: ## this list
	@$(PYTHON) msv2/cli/make_help.py

setup: ## virtual environment in .venv; EXTRAS=none|models,plots,train,synth,place,fpga,dev,viewer,cluster,judge,metrics,cuda,docs WARM=1 compiles the kernels
	@$(PYTHON) msv2/cli/setup_environment.py $(call option,EXTRAS,extras) $(call switch,WARM,warm)

base:
	@$(PYTHON) msv2/cli/setup_environment.py --extras none

tested:
	@$(PYTHON) msv2/cli/setup_environment.py --extras models,synth,dev

doctor: ## what is missing on this machine, and how to get it
	@$(or $(wildcard $(RUN)),$(PYTHON)) -m msv2 doctor

demo: base ## everything on the trained embedded scene: model, oracle, golden, RTL frame, comparison, pictures; OUT=
	@$(MSV2) demo $(call option,OUT,out)

render: base ## golden renderer; SCENE= SIZE=WxH CAMERA=auto|orbit|INDEX|NAME|FILE ORBIT=A,E,D UP= LOOK_AT= FOV= GAZE=X,Y LEVELS=N LEVELS_FROM=enhanced|spread|random LOD=N BACKGROUND= SEED= CONFIG= SET="NAME=VALUE ..." COMPARE=oracle DUMP=STAGE EFFECTS=auto|all|none|LIST DEPTH=1 OUT=; two eyes as in frame
	@$(MSV2) render $(request) $(effects) $(eyes) $(config) $(call option,COMPARE,compare) $(call option,DUMP,dump)

look: base ## contact sheet of a scene: eight cameras with the numbers to copy; SCENE= SIZE=WxH UP=auto|+x|-x|+y|-y|+z|-z LOOK_AT=X,Y,Z FOV=DEG OUT=
	@$(MSV2) look $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(standpoint) $(call option,OUT,out)

frame: base ## a frame through the RTL, compared bit for bit; what render takes but COMPARE and DUMP, and PIXELS=wide|display|packed MERGE=0|1 PIPELINE=0|1 BETA= MEMORY=ideal|lpddr3 BANDWIDTH= LATENCY= MACHINE=scene|full PART=machine|array FRAMES=N TURN=DEG STEREO=1 ECC=DEG GAZE_RIGHT=X,Y IPD=M UNITS_PER_METRE= SOURCE=left|right WAVES=1 WAVE_CYCLES=A:B
	@$(MSV2) frame $(request) $(effects) $(eyes) $(config) $(call option,PART,part) $(call option,PIXELS,pixels) $(call option,MERGE,merge) \
		$(call option,PIPELINE,pipeline) $(call option,MACHINE,machine) $(call option,FRAMES,frames) $(call option,TURN,turn) $(call option,BETA,beta) $(call option,BANDWIDTH,bandwidth) \
		$(call option,MEMORY,memory) $(call option,LATENCY,latency) $(call switch,WAVES,waves) $(call option,WAVE_CYCLES,wave-cycles)

viewable:
	@$(PYTHON) msv2/cli/setup_environment.py --extras models,viewer

view: viewable ## look at a scene in the browser; SCENE= and what render takes, PORT= HOST= BENCHMARK=1 SCREENSHOTS=1 OUT=
	@$(MSV2) view $(request) $(effects) $(eyes) $(config) $(call option,PORT,port) $(call option,HOST,host) \
		$(call switch,BENCHMARK,benchmark) $(call switch,SCREENSHOTS,screenshots)

video: base ## a film along a camera path, with the machine's numbers below; what render takes, and CAMERAS=orbit|FILE SWEEP=DEG GAZE_PATH=wander|FILE FRAMES=N FPS=F FORMAT=webp,gif,mp4 SHOW=levels|...
	@$(MSV2) video $(request) $(effects) $(eyes) $(config) $(call option,CAMERAS,path) $(call option,SWEEP,sweep) \
		$(call option,GAZE_PATH,gaze-path) $(call option,FRAMES,frames) $(call option,FPS,fps) $(call option,FORMAT,format) $(call option,SHOW,show)

sim: base ## unit simulation; TEST=float|chunk_test|chunk_reader|culling|lists|tmu|sort|vrc|warp|axi|top|supertile_test|pair_lists|record_fetch|pair_colour|batch|batch_array|frame_packer|frame_unpacker|all CONFIG= SET="NAME=VALUE ..." SEED=N WAVES=1 WAVE_CYCLES=A:B
	@$(MSV2) sim $(call option,TEST,test) $(config) $(call option,SEED,seed) \
		$(call switch,WAVES,waves) $(call option,WAVE_CYCLES,wave-cycles)

synth: tested ## synthesis; UNIT=|CONFIG= SET="NAME=VALUE ..." STEREO=1 TECH=generic|asap7|nangate45|osu018|PATH.lib CLOCK_PS=N JOBS=N RUNS=N OUT=, liberty folder in MSV2_PDK; MACHINE=1 times the linked machine, CORNER=typical|slow|PATH.lib UNCERTAINTY=0.05; BUDGET=1 adds up stored times
	@$(MSV2) synth $(call option,UNIT,unit) $(config) $(call switch,STEREO,stereo) \
		$(call option,TECH,tech) $(call option,CLOCK_PS,clock-ps) $(call option,JOBS,jobs) $(call option,RUNS,runs) $(call option,OUT,out) \
		$(call switch,MACHINE,machine) $(call option,CORNER,corner) $(call option,UNCERTAINTY,uncertainty) $(call switch,BUDGET,budget)

mappable:
	@$(PYTHON) msv2/cli/setup_environment.py --extras fpga

fpga: mappable ## the machine and a RISC-V core as a bitstream for an ECP5, and in simulation; PART=all|synthesis|bitstream|soc DEVICE=um5g-85k|85k SEED=N OUT=
	@$(MSV2) fpga $(call option,PART,part) $(call option,DEVICE,device) $(call option,SEED,seed) $(call option,OUT,out)

verilog: base ## the machine or one unit as Verilog for your own design; CONFIG= SET="NAME=VALUE ..." STEREO=1 UNIT= OUT= PREFIX=
	@$(MSV2) verilog $(config) $(call switch,STEREO,stereo) $(call option,UNIT,unit) $(call option,OUT,out) $(call option,PREFIX,prefix)

study: setup ## one experiment; NAME=list|NAME ARGS="its options" (ARGS=--help shows them)
	@$(MSV2) study $(or $(NAME),list) $(ARGS)

report-area: tested ## area and clocks of the paper's machine beside the paper's: build/reports/area.{json,md,png}; BUILDS="1ghz ..." JOBS=N RUNS=N MSV2_PDK= KEEP=1
	@$(MSV2) study area $(if $(BUILDS),--builds $(BUILDS)) $(call option,JOBS,jobs) $(call option,RUNS,runs) $(call switch,KEEP,keep)

perf: base ## cycle model beside the RTL: build/reports/model.{json,md}; RTL=1 renders its own frames through the RTL first; MSV2_DATA= KEEP=1
	@$(MSV2) study model $(call switch,RTL,rtl) $(call switch,KEEP,keep)

report-energy: base ## energy of frames by unit, of reports/energy_per_operation.json: build/reports/energy.{json,md,png}; SCENE= SIZE= GAZE= LEVELS= CONFIG= SET="NAME=VALUE ..." CLOCK_MHZ= FRAME=frame.json OUT= KEEP=1
	@$(MSV2) study energy $(request) $(eyes) $(config) $(call option,CLOCK_MHZ,clock-mhz) $(call option,FRAME,frame) $(call switch,KEEP,keep)

report-performance: setup ## machines on the same frames beside the paper, GSCore, a GPU: build/reports/performance.{json,md}, performance_*.png; SCENE= SIZE= OUT= KEEP=1
	@$(MSV2) study performance $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,OUT,out) $(call switch,KEEP,keep)

report: setup ## area, energy and performance as one page: build/report/report.{html,md,json}; SCENE=|all SIZE= AREA=kept|measured SCREENSHOTS=1 OUT=
	@$(MSV2) study report $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,AREA,area) \
		$(call switch,SCREENSHOTS,screenshots) $(call option,OUT,out)

sweep: setup ## cycles, area and energy over many settings; SWEEP=FILE.toml JOBS=N SCHEDULER=ADDRESS OUT=
	@$(MSV2) sweep $(if $(SWEEP),"$(SWEEP)") $(call option,JOBS,jobs) $(call option,SCHEDULER,scheduler) $(call option,OUT,out)

train: setup ## foveated training; SCENE= VARIANT=H|M|L FROM=dense.ply BASELINE=smfr|mmfr|count|importance|speedy|pup|compact|lightgs SIZE= ITERATIONS= SEED= DEVICE= RESUME=1 OUT=
	@$(MSV2) train $(if $(SCENE),"$(SCENE)") $(call option,VARIANT,variant) $(call option,FROM,from) \
		$(call option,BASELINE,baseline) $(call option,SIZE,size) $(call option,ITERATIONS,iterations) $(call option,SEED,seed) \
		$(call option,DEVICE,device) $(call switch,RESUME,resume) $(call option,OUT,out)

tables-training: setup ## the paper's tables of training; SCENE="one another@WxH" TABLES=pruning,... VARIANT= SIZE= ITERATIONS= RTL=0|1 OUT= NAME= KEEP=1
	@$(MSV2) study training $(SCENE) $(call option,VARIANT,variant) $(call option,SIZE,size) \
		$(call option,ITERATIONS,iterations) $(call option,TABLES,tables) $(if $(filter 0,$(RTL)),--no-rtl) $(call option,OUT,out) $(call option,NAME,name) $(call switch,KEEP,keep)

table-ecc: setup ## the threshold of selective warping: quality, work and cost of two eyes; SCENE="one another@WxH" SIZE= POSES= THRESHOLDS= IPD= UNITS_PER_METRE= V1= TRAIN_V1=1 RTL=all|NAME OUT= NAME= KEEP=1
	@$(MSV2) study threshold $(SCENE) $(call option,SIZE,size) $(call option,POSES,poses) $(call option,THRESHOLDS,thresholds) \
		$(call option,UNITS_PER_METRE,units-per-metre) $(call option,IPD,ipd) $(call option,V1,v1) \
		$(call switch,TRAIN_V1,train-v1) $(call option,RTL,rtl) $(call option,OUT,out) $(call option,NAME,name) $(call switch,KEEP,keep)

table-effects: base ## what a scene does not pay for; SCENE="one another@X,Y" SIZE= RTL=WxH CONFIG= SET="NAME=VALUE ..." AREA=1 (MSV2_PDK=) OUT= KEEP=1
	@$(MSV2) study effects $(SCENE) $(call option,SIZE,size) $(call option,RTL,rtl) $(config) $(call switch,AREA,area) $(call option,OUT,out) $(call switch,KEEP,keep)

tradeoff: setup ## what accuracy costs in time: machine, simulation, training; SCENE= SIZE= VIEWS= VARIANT=NAME=PATH RTL=1 JOBS=N SCHEDULER=ADDRESS OUT= KEEP=1
	@$(MSV2) study tradeoff $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,VIEWS,views) $(call option,VARIANT,variant) \
		$(call switch,RTL,rtl) $(call option,JOBS,jobs) $(call option,SCHEDULER,scheduler) $(call option,OUT,out) $(call switch,KEEP,keep)

bench: setup ## renderer speeds side by side; SCENE= SIZE=WxH OUT= KEEP=1
	@$(MSV2) study speed $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,OUT,out) $(call switch,KEEP,keep)

results: setup ## everything that the generated tables rest on; with KEEP=1 into reports/ and docs/; MSV2_DATA= MSV2_PDK= ONLY=part UNIT=name KEEP=1
	@$(MSV2) study results $(call option,ONLY,only) $(call option,UNIT,unit) $(call switch,KEEP,keep)

stability: setup ## hard cases on oracle, golden, gradients, RTL, and seeded faults; CASE= COLUMNS=oracle,golden,... OUT= KEEP=1
	@$(MSV2) study stability $(call option,CASE,case) $(call option,COLUMNS,columns) $(call option,OUT,out) $(call switch,KEEP,keep)

documented:
	@$(PYTHON) msv2/cli/setup_environment.py --extras docs

docs: documented ## the generated pages of docs/, and the site of all pages and docstrings in build/docs; SITE=0: the pages alone; OUT=
	@$(MSV2) docs $(if $(filter 0,$(SITE)),,--site) $(call option,OUT,out)

check: tested ## what a change needs at once: linter, types, and the quick tests without Verilator and torch
	@$(RUN) -m msv2.cli.check

test: tested ## the tests, on all cores (minutes)
	@$(TESTS) -m "not long"

test-long: tested ## the long tests as well
	@$(TESTS)

lint: tested ## ruff
	@$(RUN) -m ruff check .
