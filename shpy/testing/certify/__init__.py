"""`shpy certify`: whether a device gives the bits that the package ships, told by one command.

Stage: test. `sections` lists the checks, `running` runs them on a target, `report` prints and saves the findings.
"""
