"""The library as its users meet it: what ``import hybrid_sysid_ros as hs`` offers. Arguments are checked here, once."""
