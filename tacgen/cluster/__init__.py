"""Batch jobs through submitit: submitting shards or a long command, and their states."""
