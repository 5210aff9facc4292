"""What `--help` says beyond a command's options: panels and examples."""
