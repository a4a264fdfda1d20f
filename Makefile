CARGO ?= cargo
SCENE := scenes/cornell/cornell.toml
TWOPASS := $(or $(CARGO_TARGET_DIR),target)/release/twopass

.PHONY: help setup build render test lint bench tables test-debian13

help:
	@echo "make render         render $(SCENE) to out/cornell.exr and out/cornell.png"
	@echo "make test           run every test, documentation examples included"
	@echo "make lint           check formatting, clippy and the documentation"
	@echo "make bench          measure everything (forty minutes) and write out/bench/report.html"
	@echo "make tables         put the measured tables into the README"
	@echo "make test-debian13  run the tests in a Debian 13 root (Embree 4, cargo 1.85); needs root"
	@echo "make setup          install the Debian packages that are missing"

setup:
	@bash ci/setup.sh

build: setup
	$(CARGO) build --release --locked

render: build
	@mkdir -p out
	$(TWOPASS) render $(SCENE) -o out/cornell.exr -o out/cornell.png --exposure 1

# The test profile, opt-level 2: building it takes a quarter less processor time than the release profile
# with its link-time optimisation.
# --show-output: says which Embree and OpenImageIO ran, and which tests found no reference data.
test: setup
	$(CARGO) test --locked -- --show-output

# The test profile: macros and build scripts that the tests have built serve here too.
lint: setup
	$(CARGO) fmt --check
	$(CARGO) clippy --locked --all-targets --profile test -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --locked --no-deps --profile test

bench: build
	$(TWOPASS) bench -o out/bench

tables:
	$(TWOPASS) bench --tables README.md -o out/bench

test-debian13: setup
	@bash ci/debian13.sh
