"""Batch jobs: shards handed to a scheduler through submitit, and what became of them."""

from tacgen.cluster.command import require_command, submit_command, wait_for_command
from tacgen.cluster.states import Status, job_states, jobs_text, status, status_text
from tacgen.cluster.submission import Request, Submitted, submit, wait_for

__all__ = [
    "Request",
    "Status",
    "Submitted",
    "job_states",
    "jobs_text",
    "require_command",
    "status",
    "status_text",
    "submit",
    "submit_command",
    "wait_for",
    "wait_for_command",
]
