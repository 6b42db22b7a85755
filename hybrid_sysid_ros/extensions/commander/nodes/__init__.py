"""The commander's node and its clients."""
