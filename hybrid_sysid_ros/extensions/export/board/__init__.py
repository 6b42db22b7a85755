"""A loop on a microcontroller: its folder, its emulator, and the frames on its serial line."""
