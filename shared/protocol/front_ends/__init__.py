"""What the emulator asks a front end in another process, in any language, and what it answers."""
