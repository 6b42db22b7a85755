"""Playback: recorded messages published again, and recorded loops answered again."""
