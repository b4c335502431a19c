"""The experiments: results, the programs that make them again, and the report."""
