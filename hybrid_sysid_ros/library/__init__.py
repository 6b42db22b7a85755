"""The public functions of ``import hybrid_sysid_ros as hs``. Arguments are checked here, once."""
