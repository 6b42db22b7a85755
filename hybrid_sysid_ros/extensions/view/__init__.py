"""View: a running rig on a page of this computer."""
