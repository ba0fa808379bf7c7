"""What the subcommands of `offtrack` do, a module each; `scenarios.cli` puts them together."""
