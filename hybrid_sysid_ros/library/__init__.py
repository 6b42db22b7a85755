"""The library as its users meet it: what ``import hybrid_sysid_ros as hs`` offers, and the commands call.

Arguments are checked here, once; below it they are taken for what they are declared.
"""
