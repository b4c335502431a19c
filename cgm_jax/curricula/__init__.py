"""What to practise.

masking.py  curriculum goal masking: which goal dimensions to keep, by estimated success
"""
