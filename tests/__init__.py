"""The run-time type checker of the tests: shapes by jaxtyping, and an int is as good as a float (PEP 484)."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
