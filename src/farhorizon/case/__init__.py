"""Case files: TOML to a set-up."""
