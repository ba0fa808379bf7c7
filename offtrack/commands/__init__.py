"""Subcommands of `offtrack`, one module each; `offtrack.commands.cli` assembles them."""
