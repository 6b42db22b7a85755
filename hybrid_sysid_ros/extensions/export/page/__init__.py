"""A page with the rig and its controller in it, as WebAssembly."""
