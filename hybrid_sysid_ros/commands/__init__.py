"""Commands of hybrid-sysid, one file each."""
