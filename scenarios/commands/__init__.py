"""Subcommands of `offtrack`, one module each; `scenarios.cli` assembles them."""
