"""Looking at the text of the user's functions: parsed files, scopes, the flow of names, and what a line says.

Stage: record, before and beside it. Takes source files and functions; gives errors and hints, never IR.

    check_source(function, is_value=...)     # in shpy.lang.source_check, which is the door to this package
"""
