"""Scripts behind the targets of the Makefile; run them from the repository root."""
