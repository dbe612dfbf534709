"""The flight core in C99, equal to the numpy core, and what builds it. README.md says what is done and how."""
