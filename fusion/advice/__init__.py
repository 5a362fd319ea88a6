"""Advice: a finding's fix is tried before anybody reads it, and only what helps is offered. Nothing here fuses."""
