"""Everything that carries messages: codec, bus, runner, trace."""
