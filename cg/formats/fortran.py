"""A step in Fortran: a module."""

from collections.abc import Mapping, Sequence

from cg.formats.language import Language
from cg.formats.program import Program
from cg.formats.text import real, wrapped

_MAX_ENTRIES = 200  # of an array in one statement; older standards allow 255 continuation lines
_MAX_WIDTH = 120  # of a piece of a number; the standard allows lines of 132 characters

_MODULE = """@heading@
module @name@_method
  implicit none
  private
  public :: @name@_step

  ! The kind of all numbers
  integer, parameter, public :: @name@_wp = kind(1.0d0)
  integer, parameter :: wp = @name@_wp

  abstract interface

    ! The coefficients f of the frame's fields at a point
    subroutine f_i(t, y, f)
      import :: wp
      real(wp), intent(in) :: t
      real(wp), intent(in) :: y(:)        ! (n)
      real(wp), intent(out) :: f(:)       ! (m)
    end subroutine f_i

    ! Advances a point along the time-1 flow of the field with coefficients v
    subroutine flow_i(v, y)
      import :: wp
      real(wp), intent(in) :: v(:)        ! (m)
      real(wp), intent(inout) :: y(:)     ! (n)
    end subroutine flow_i
@interface@
  end interface

  ! Slots hold points; slot 0 holds the initial one. Each stage has an abscissa c, the number of
  ! moves before it, and a slot. Each move is a flow from one slot to another, along the weighted
  ! sum of the fields at stages.
@tables@

contains

  ! Advances a point by a step of size h from time t@remark@
  subroutine @name@_step(f, flow, @dexpinv@m, t, h, y@argument@)
    procedure(f_i) :: f
    procedure(flow_i) :: flow
@declare_dexpinv@    integer, intent(in) :: m               ! number of fields
    real(wp), intent(in) :: t, h
    real(wp), intent(inout) :: y(:)        ! (n)
@declare@    real(wp) :: points(size(y), 0:@slots@ - 1), fields(m, @stages@), v(m)@more@
    integer :: stage, done@index@

    points(:, 0) = y
    done = 0
    do stage = 1, @stages@
      call move_to(before(stage))
      call f(t + c(stage) * h, points(:, slot(stage)), fields(:, stage))
@derivative@    end do
    call move_to(@moves@)
    y = points(:, @result@)
@output@
  contains

    subroutine move_to(last)
      integer, intent(in) :: last
      integer :: move, i

      do move = done + 1, last
        i = first(move)
        v = (h * weight(i)) * fields(:, term_stage(i))
        do i = first(move) + 1, first(move + 1) - 1
          v = v + (h * weight(i)) * fields(:, term_stage(i))
        end do
@keep@        points(:, target(move)) = points(:, origin(move))
        call flow(v, points(:, target(move)))
      end do
      done = last
    end subroutine move_to

  end subroutine @name@_step

end module @name@_method
"""

_DEXPINV = """
    ! Replaces the coefficients v of the velocity of a point with coordinates u by u'
    subroutine dexpinv_i(u, v)
      import :: wp
      real(wp), intent(in) :: u(:)        ! (m)
      real(wp), intent(inout) :: v(:)     ! (m)
    end subroutine dexpinv_i
"""

_ALGEBRA = {
    "interface": _DEXPINV,
    "dexpinv": "dexpinv, ",
    "declare_dexpinv": "    procedure(dexpinv_i) :: dexpinv\n",
    "more": ", u(m, 0:@slots@ - 1)",
    "keep": "        u(:, target(move)) = v\n",
    "derivative": (
        "      if (slot(stage) > 0) call dexpinv(u(:, slot(stage)), fields(:, stage))\n"
    ),
}

_PAIR = {
    "remark": ". The second result is of order @lower@.",
    "argument": ", second",
    "declare": "    real(wp), intent(out), optional :: second(:)   ! (n)\n",
    "output": "    if (present(second)) second = points(:, @second_slot@)\n",
}

_ERROR_REMARKS = {
    1: """. The coefficients of its
  ! error are those of the field whose flow joins the two results.""",
    2: """. The coefficients of its
  ! error are e and e_3, and the estimate |e|^2 / sqrt(|e|^2 + 0.01 |e_3|^2).""",
}


_ERROR = {
    "argument": ", error",
    "declare": "    real(wp), intent(out), optional :: error(:, :) ! (m, @errors@)\n",
    "output": """    if (present(error)) then
      do k = 1, @errors@
        error(:, k) = (h * error_weight(1, k)) * fields(:, 1)
        do j = 2, @stages@
          error(:, k) = error(:, k) + (h * error_weight(j, k)) * fields(:, j)
        end do
      end do
    end if
""",
    "index": ", j, k",
}


def _tables(program: Program, integers: Mapping[str, list[str]]) -> str:
    lines = [
        *(line for name, values in integers.items() for line in _array("integer", name, values)),
        *_array("real(wp)", "weight", _numbers(program.term_weights)),
        *_array("real(wp)", "c", _numbers(program.c)),
    ]
    if program.errors:
        flat = [weight for row in program.errors for weight in row]
        lines += _array("real(wp)", "flat_error_weight", _numbers(flat))
        shape = f"{program.stages}, {len(program.errors)}"
        lines.append(
            f"  real(wp), parameter :: error_weight({shape}) = "
            f"reshape(flat_error_weight, [{shape}])"
        )
    return "\n".join(lines)


def _numbers(texts: Sequence[str]) -> list[str]:
    """Return real literals of kind wp; long ones continue over several lines."""
    numbers = [f"{real(text)}_wp" for text in texts]
    return [
        "&\n&".join(number[k : k + _MAX_WIDTH] for k in range(0, len(number), _MAX_WIDTH))
        for number in numbers
    ]


def _array(kind: str, name: str, entries: Sequence[str]) -> list[str]:
    """Return the declaration of an array; a long one is joined from several."""
    if not entries:
        return [f"  {kind}, parameter :: {name}(0) = [{kind} ::]"]
    if len(entries) <= _MAX_ENTRIES:
        body = wrapped(entries, "    ", end=" &")
        return [f"  {kind}, parameter :: {name}({len(entries)}) = [ &\n{body}]"]
    lines = []
    names = []
    for number, k in enumerate(range(0, len(entries), _MAX_ENTRIES), 1):
        names.append(f"{name}_{number}")
        lines += _array(kind, names[-1], entries[k : k + _MAX_ENTRIES])
    joined = wrapped(names, "    ", end=" &")
    return [*lines, f"  {kind}, parameter :: {name}({len(entries)}) = [ &\n{joined}]"]


FORTRAN = Language(
    _MODULE, mark="!", slot=0, term=1, tables=_tables, pair=_PAIR, error=_ERROR,
    remarks=_ERROR_REMARKS, algebra=_ALGEBRA,
)  # fmt: skip
