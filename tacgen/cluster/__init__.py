"""Batch jobs: shards handed to a scheduler through submitit, and what became of them."""

from tacgen.cluster.states import Status, status, status_text
from tacgen.cluster.submission import Request, Submitted, submit, wait_for

__all__ = ["Request", "Status", "Submitted", "status", "status_text", "submit", "wait_for"]
