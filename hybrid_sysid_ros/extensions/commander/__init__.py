"""Commander: commands in plain language, and their MCP server."""
