"""Where ends are over time, and how they are turned."""
