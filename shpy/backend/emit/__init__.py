"""From prepared IR to text: what the targets share.

Stage: emit. Each decision is made in one stage, and each stage gives something that can be looked at; docs/design.md
lists them. The output tree is immutable, so a pass over it gives a new one.

A target derives from `Unit` and `Body` and overrides what differs; it never looks at text. To spell one
function:

    body = OwnBody(unit, function)          # names nothing yet
    parameters = ...                        # put a Name into body.exprs or body.slots for each port
    body.begin(returns=True)                # finds what needs the whole function
    body.statements()                       # fills body.out with statements of the tree
    block = own_pass(tuple(body.out))       # what only this target wants, such as guards of loops
    speller.function(tree.Function(name, result, parameters, block))

Hooks of `Body` that a target may override: the `op_<name>` of an operation, `let`, `bind`, `store`, `assign`, `call`,
`loop`, `looped`, `declare_zero`, `leave`, and what names depend on: `apart`, `repeats`.
"""
