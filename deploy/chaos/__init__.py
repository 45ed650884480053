"""Faults and attacks on purpose, and what came of them."""
