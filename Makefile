# Targets only dispatch to Python; every command line has --help.
PYTHON ?= python3
RUN := .venv/bin/python
TESTS := $(RUN) -m pytest -n auto --dist worksteal
EXTRAS ?=

option = $(if $($(1)),--$(2) "$($(1))")
config = $(call option,CONFIG,config) $(foreach set,$(SET),--set "$(set)")
request = $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,CAMERA,camera) $(call option,GAZE,gaze) \
	$(call option,LEVELS,levels) $(call option,BACKGROUND,background) $(call option,SEED,seed) $(call option,EFFECTS,effects) $(call option,OUT,out)

eyes = $(if $(filter-out 0,$(STEREO)),--stereo) $(call option,ECC,ecc-thresh) $(call option,IPD,ipd) \
	$(call option,UNITS_PER_METRE,units-per-metre) $(call option,SOURCE,source) $(call option,GAZE_RIGHT,gaze-right)

.DEFAULT_GOAL := help
.PHONY: help setup base tested demo render frame sim synth perf report-area report-energy report-performance report train tables-training table-ecc table-effects tradeoff bench results stability docs test test-long lint

help: ## this list
	@$(PYTHON) msv2/cli/make_help.py

setup: ## virtual environment in .venv; EXTRAS=none|models,train,synth,dev,viewer,metrics,cuda
	@$(PYTHON) msv2/cli/setup_environment.py $(if $(EXTRAS),--extras $(EXTRAS))

base:
	@$(PYTHON) msv2/cli/setup_environment.py --extras none

tested:
	@$(PYTHON) msv2/cli/setup_environment.py --extras models,synth,dev

demo: base ## everything on the embedded scene: model, oracle, golden, RTL frame, comparison, pictures
	@$(RUN) -m msv2.cli.demo $(call option,OUT,out)

render: base ## golden renderer; SCENE= SIZE=WxH CAMERA= GAZE=X,Y LEVELS=N CONFIG= SET="NAME=VALUE ..." COMPARE=oracle DUMP=STAGE EFFECTS=auto|all|none|LIST DEPTH=1 OUT=; two eyes as in frame
	@$(RUN) golden/render.py $(request) $(eyes) $(config) $(call option,COMPARE,compare) $(call option,DUMP,dump) $(if $(filter-out 0,$(DEPTH)),--depth)

frame: base ## a frame through the RTL, compared bit for bit; SCENE= SIZE= CONFIG= SET="NAME=VALUE ..." GAZE=X,Y PIXELS=wide|display MERGE=0|1 PIPELINE=0|1 BETA= BANDWIDTH= EFFECTS= MACHINE=scene|full STEREO=1 ECC=DEG GAZE_RIGHT=X,Y IPD=M UNITS_PER_METRE= SOURCE=left|right
	@$(RUN) -m tb.frame $(request) $(eyes) $(config) $(call option,PART,part) $(call option,PIXELS,pixels) $(call option,MERGE,merge) \
		$(call option,PIPELINE,pipeline) $(call option,MACHINE,machine) $(call option,BETA,beta) $(call option,BANDWIDTH,bandwidth) $(call option,LATENCY,latency)

sim: base ## unit simulation; TEST=float|culling|lists|tmu|sort|vrc|warp|axi|top|all CONFIG= SET="NAME=VALUE ..." SEED=N WAVES=1 WAVE_CYCLES=A:B
	@$(RUN) -m tb.sim $(call option,TEST,test) $(config) $(call option,SEED,seed) \
		$(if $(filter-out 0,$(WAVES)),--waves) $(call option,WAVE_CYCLES,wave-cycles)

synth: tested ## synthesis; UNIT=|CONFIG= SET="NAME=VALUE ..." STEREO=1 TECH=generic|asap7|nangate45|osu018|PATH.lib CLOCK_PS=N JOBS=N RUNS=N, liberty folder in MSV2_PDK
	@$(RUN) -m synth $(call option,UNIT,unit) $(config) $(if $(filter-out 0,$(STEREO)),--stereo) \
		$(call option,TECH,tech) $(call option,CLOCK_PS,clock-ps) $(call option,JOBS,jobs) $(call option,RUNS,runs) $(call option,OUT,out)

report-area: tested ## area and clocks of the paper's machine beside the paper's: reports/area.{json,md,png}; BUILDS="1ghz ..." JOBS=N RUNS=N MSV2_PDK=
	@$(RUN) -m msv2.studies area $(if $(BUILDS),--builds $(BUILDS)) $(call option,JOBS,jobs) $(call option,RUNS,runs)

perf: base ## cycle model beside the RTL: reports/model.{json,md}; RTL=1 renders its own frames through the RTL first; MSV2_DATA=
	@$(RUN) -m msv2.studies model $(if $(filter-out 0,$(RTL)),--rtl)

report-energy: base ## energy of frames by unit, of reports/energy_per_operation.json: reports/energy.{json,md,png}; SCENE= SIZE= GAZE= LEVELS= CONFIG= SET="NAME=VALUE ..." CLOCK_MHZ= FRAME=frame.json OUT=
	@$(RUN) -m msv2.studies energy $(request) $(eyes) $(config) $(call option,CLOCK_MHZ,clock-mhz) $(call option,FRAME,frame)

report-performance: setup ## machines on the same frames beside the paper, GSCore, a GPU: reports/performance.{json,md}, performance_*.png; SCENE= SIZE= OUT=
	@$(RUN) -m msv2.studies performance $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,OUT,out)

report: setup ## area, energy and performance as one page: build/report/report.{html,md,json}; SCENE= SIZE= AREA=kept|measured OUT=
	@$(RUN) -m msv2.studies report $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,AREA,area) $(call option,OUT,out)

train: setup ## foveated training; SCENE= VARIANT=H|M|L FROM=dense.ply BASELINE=smfr|mmfr|count|importance SIZE= ITERATIONS= DEVICE= RESUME=1 OUT=
	@$(RUN) golden/train.py $(if $(SCENE),"$(SCENE)") $(call option,VARIANT,variant) $(call option,FROM,from) \
		$(call option,BASELINE,baseline) $(call option,SIZE,size) $(call option,ITERATIONS,iterations) \
		$(call option,DEVICE,device) $(if $(filter-out 0,$(RESUME)),--resume) $(call option,OUT,out)

tables-training: setup ## the paper's tables of training; SCENE="one another@WxH" TABLES=pruning,... VARIANT= SIZE= ITERATIONS= RTL=0|1 OUT= NAME=
	@$(RUN) -m msv2.studies training $(SCENE) $(call option,VARIANT,variant) $(call option,SIZE,size) \
		$(call option,ITERATIONS,iterations) $(call option,TABLES,tables) $(if $(filter 0,$(RTL)),--no-rtl) $(call option,OUT,out) $(call option,NAME,name)

table-ecc: setup ## the threshold of selective warping: quality, work and cost of two eyes; SCENE="one another@WxH" SIZE= POSES= UNITS_PER_METRE= V1= TRAIN_V1=1 RTL=all|NAME OUT= NAME=
	@$(RUN) -m msv2.studies threshold $(SCENE) $(call option,SIZE,size) $(call option,POSES,poses) $(call option,THRESHOLDS,thresholds) \
		$(call option,UNITS_PER_METRE,units-per-metre) $(call option,IPD,ipd) $(call option,V1,v1) \
		$(if $(filter-out 0,$(TRAIN_V1)),--train-v1) $(call option,RTL,rtl) $(call option,OUT,out) $(call option,NAME,name)

table-effects: base ## what a scene does not pay for; SCENE="one another@X,Y" SIZE= RTL=WxH CONFIG= SET="NAME=VALUE ..." AREA=1 (MSV2_PDK=) OUT=
	@$(RUN) -m msv2.studies effects $(SCENE) $(call option,SIZE,size) $(call option,RTL,rtl) $(config) $(if $(filter-out 0,$(AREA)),--area) $(call option,OUT,out)

tradeoff: setup ## what accuracy costs in time: machine, simulation, training; SCENE= SIZE= VIEWS= VARIANT=NAME=PATH RTL=1 JOBS=N SCHEDULER=ADDRESS OUT=
	@$(RUN) -m msv2.studies tradeoff $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,VIEWS,views) $(call option,VARIANT,variant) \
		$(if $(filter-out 0,$(RTL)),--rtl) $(call option,JOBS,jobs) $(call option,SCHEDULER,scheduler) $(call option,OUT,out)

bench: setup ## renderer speeds side by side; SCENE= SIZE=WxH
	@$(RUN) -m msv2.studies speed $(if $(SCENE),"$(SCENE)") $(call option,SIZE,size) $(call option,OUT,out)

results: setup ## everything the README's tables rest on, into reports/; MSV2_DATA= MSV2_PDK= ONLY=part UNIT=name
	@$(RUN) -m msv2.studies results $(call option,ONLY,only) $(call option,UNIT,unit)

stability: setup ## hard cases on oracle, golden, gradients, RTL, and seeded faults; CASE= COLUMNS=oracle,golden,... OUT= KEEP=1
	@$(RUN) -m msv2.cases $(call option,CASE,case) $(call option,COLUMNS,columns) $(call option,OUT,out) $(if $(filter-out 0,$(KEEP)),--keep)

docs: tested ## regenerate the generated pages of docs/
	@$(RUN) -m msv2.document

test: tested ## the tests, on all cores (minutes)
	@$(TESTS) -m "not long"

test-long: tested ## the long tests as well
	@$(TESTS)

lint: tested ## ruff
	@$(RUN) -m ruff check .
