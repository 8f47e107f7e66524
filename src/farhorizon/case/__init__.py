"""Case files: from TOML to a set-up."""
