"""What the commands share: options, console, streams, exit codes."""
