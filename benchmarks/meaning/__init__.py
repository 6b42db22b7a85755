"""Meaning: what must not mislead. Each part measures one thing, and names the rows that fall short."""
