"""From prepared IR to text: what the targets share.

Stage: emit. Each decision is made in one stage, and each stage gives something that can be looked at:

    names       makes every name a legal, unique identifier of the target
    entry       `Unit`, one text: the module, its global names, what each function needs besides its arguments
    survey      facts of a function: where values are made and used, which statements touch a variable
    plan        which value gets a name, where variables are declared, what stands in the head of a loop: from ids
    late        the same where names hold to the end of a function and need no declaration, as in Python
    operations  an operation as an expression of the output tree
    structure   `Body`, the tree of one function: for, while, do, early returns. It asks the plan and the operations
    tree        the output tree. It is immutable, so a pass over it gives a new one
    spell_c, spell_python
                text of a tree: brackets, literals, keywords, comments with the user's line

A target derives from `Unit` and `Body` and says what it does in its own way; it never looks at text. To spell one
function:

    body = OwnBody(unit, function)          # names nothing yet
    parameters = ...                        # put a Name into body.exprs or body.slots for each port
    body.begin(returns=True)                # plans
    body.statements()                       # fills body.out with statements of the tree
    block = own_pass(tuple(body.out))       # what only this target wants, such as guards of loops
    speller.function(tree.Function(name, result, parameters, block))

Hooks of `Body` that a target may override: the `op_<name>` of an operation, `let`, `bind`, `store`, `assign`, `call`,
`loop`, `looped`, `declare_zero`, `leave`, `result`, and what the plan asks: `apart`, `repeats`, `letters`.
"""
