# The two commands: make demo, make test. Everything else is below `make help`.
CARGO ?= cargo
PACKAGES := build-essential pkg-config libclang-dev libgphoto2-dev
DEMO_OUTPUT ?= demo-output

.PHONY: help demo test lint bench package test-machine build dependencies

help:
	@echo 'make demo          a bundled flight through the real daemon; ends with a store and a report'
	@echo 'make test          formatting, lints, every test (Debian 12: installs what it lacks)'
	@echo 'make bench         the figures of docs/performance.md'
	@echo 'make package       a Debian package in target/package'
	@echo 'make test-machine  cameras, GPIO and systemd in virtual machines'

demo: build
	target/release/wingd demo --output $(DEMO_OUTPUT)

test: dependencies lint
	$(CARGO) test --release --locked

lint: dependencies
	$(CARGO) fmt --check
	$(CARGO) clippy --release --locked --all-targets -- -D warnings

# With one test, so that the dependencies get the tests' features and are not built twice.
build: dependencies
	$(CARGO) build --release --locked --bins --test layers

bench: build
	sh benches/run.sh

package: build
	sh packaging/build.sh

test-machine: build
	sh tests/machine/run.sh

# Installs the Debian packages that are missing, as root or through sudo; elsewhere says which.
dependencies:
	@sh packaging/dependencies.sh $(PACKAGES)
