"""Report: pages of HTML on models, and figures in notebooks."""
