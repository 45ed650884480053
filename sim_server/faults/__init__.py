"""Faults on purpose: one small file per fault or family. Each has its settings, its effect, and what is counted of it.

:mod:`sim_server.faults.registry` knows them all; docs/chaos.md is its table.
"""
