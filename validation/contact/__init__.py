"""Whether the tracer can be trusted: effects put in on purpose, and what it makes of them."""
