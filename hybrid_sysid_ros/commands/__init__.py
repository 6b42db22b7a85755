"""hybrid-sysid ...: a file a command."""
