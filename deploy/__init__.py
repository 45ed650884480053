"""Command line, launcher, faults and verdicts, containers."""
