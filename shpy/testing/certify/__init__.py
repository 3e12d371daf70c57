"""`shpy certify`: whether a device gives the bits that the package ships, told by one command.

Stage: test. `sections` says what is checked, `running` runs it on a target, `report` prints and keeps what was found.
"""
