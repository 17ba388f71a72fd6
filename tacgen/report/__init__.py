"""Self-contained HTML reports in one style."""
