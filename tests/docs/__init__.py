"""The documentation as tests: every code block runs or says where it does, every link leads somewhere."""
