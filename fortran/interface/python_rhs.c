/* Calls a right-hand side that is a function in Python, as if it were one in C.
 *
 * The user data is a pointer to a tuple, whose entries are listed below.  In the list SPARE are the
 * arrays that f was given last, or None.  If nobody else has kept one, the next numbers go into it,
 * except without a global lock, where another thread may be about to take it.
 */
#include <math.h>
#include <string.h>

#define NO_IMPORT_ARRAY /* the module imports it */
#include "fortranobject.h"
#include "shared_numbers.h"

#ifdef Py_GIL_DISABLED
enum { REUSE = 0 };
#else
enum { REUSE = 1 };
#endif
enum {
    FUNCTION,    /* f */
    ARGUMENTS,   /* its further arguments */
    LIKE_POINT,  /* an array of the shape and the type of its points */
    LIKE_RESULT, /* one of its results */
    CHECK,       /* check(value, t, y) returns other than plain results as an array, or raises */
    SPARE,       /* a list of two entries */
    OF_TIME,     /* whether f takes no point */
    INPUT,       /* whether f gets the value of its first argument, a function of time */
    CHANGING     /* whether the numbers of the last argument, an array, change between calls */
};
enum { POINT, NUMBERS }; /* slots of SPARE */

/* Whether an array has the shape and the type of another one, and plain memory */
static int is_like(PyArrayObject *array, PyArrayObject *other)
{
    return PyArray_TYPE(array) == PyArray_TYPE(other) && PyArray_SAMESHAPE(array, other)
           && PyArray_ISCARRAY_RO(array);
}

/* The array in a slot of SPARE, which is then empty: f may call itself by way of another integration.
 * NULL if somebody has it still, as a whole or as a part, or has turned it into another one. */
static PyObject *take_spare(PyObject *context, int slot, PyArrayObject *like)
{
    PyObject *spare = PyTuple_GET_ITEM(context, SPARE);
    PyObject *array = PyList_GET_ITEM(spare, slot);
    if (!REUSE || array == Py_None || Py_REFCNT(array) != 1
        || !is_like((PyArrayObject *)array, like)
        || !PyArray_CHKFLAGS((PyArrayObject *)array, NPY_ARRAY_OWNDATA)) {
        return NULL;
    }
    Py_INCREF(Py_None);
    PyList_SET_ITEM(spare, slot, Py_None); /* its reference is the caller's now */
    return array;
}

static void keep_spare(PyObject *context, int slot, PyObject *array)
{
    if (REUSE) {
        Py_INCREF(array);
        PyList_SetItem(PyTuple_GET_ITEM(context, SPARE), slot, array);
    }
}

/* Numbers are given as arrays of their own, which the function may keep but not change. */
static PyObject *make_array(PyObject *context, int slot, PyObject *example, const void *numbers)
{
    PyArrayObject *like = (PyArrayObject *)example;
    PyObject *array = take_spare(context, slot, like);
    if (array == NULL) {
        array = PyArray_SimpleNew(PyArray_NDIM(like), PyArray_DIMS(like), PyArray_TYPE(like));
    }
    if (array != NULL) {
        memcpy(PyArray_DATA((PyArrayObject *)array), numbers,
               PyArray_NBYTES((PyArrayObject *)array));
        PyArray_CLEARFLAGS((PyArrayObject *)array, NPY_ARRAY_WRITEABLE);
    }
    return array;
}

static PyObject *call(PyObject *context, PyObject *time, PyObject *point)
{
    PyObject *extra = PyTuple_GET_ITEM(context, ARGUMENTS);
    Py_ssize_t count = PyTuple_GET_SIZE(extra);
    PyObject **arguments = PyMem_New(PyObject *, 3 + count);
    if (arguments == NULL) {
        return PyErr_NoMemory();
    }
    arguments[0] = NULL; /* the function may use this place during the call */
    Py_ssize_t nargs = 0, first = 0;
    PyObject *value = NULL, *input = NULL, *numbers = NULL;
    arguments[++nargs] = time;
    if (PyTuple_GET_ITEM(context, OF_TIME) != Py_True) {
        arguments[++nargs] = point;
    }
    if (PyTuple_GET_ITEM(context, INPUT) == Py_True) {
        input = PyObject_CallOneArg(PyTuple_GET_ITEM(extra, first++), time);
        if (input == NULL) {
            goto done;
        }
        arguments[++nargs] = input;
    }
    for (Py_ssize_t i = first; i < count; i++) {
        arguments[++nargs] = PyTuple_GET_ITEM(extra, i);
    }
    if (PyTuple_GET_ITEM(context, CHANGING) == Py_True) {
        PyObject *last = arguments[nargs];
        numbers = make_array(context, NUMBERS, last, PyArray_DATA((PyArrayObject *)last));
        if (numbers == NULL) {
            goto done;
        }
        arguments[nargs] = numbers;
    }
    value = PyObject_Vectorcall(PyTuple_GET_ITEM(context, FUNCTION), arguments + 1,
                                (size_t)nargs | PY_VECTORCALL_ARGUMENTS_OFFSET, NULL);
    if (numbers != NULL) {
        keep_spare(context, NUMBERS, numbers);
    }
done:
    PyMem_Free(arguments);
    Py_XDECREF(numbers);
    Py_XDECREF(input);
    return value;
}

/* Copies a float of Python or NumPy, or lists or tuples of them along the axes from one on, to a
 * place that moves behind them; returns 0 if it is another value. */
static int copy_numbers(PyObject *value, PyArrayObject *like, int axis, double **place)
{
    if (axis == PyArray_NDIM(like)) {
        if (!PyFloat_Check(value)) {
            return 0;
        }
        *(*place)++ = PyFloat_AS_DOUBLE(value);
        return 1;
    }
    if (!(PyList_CheckExact(value) || PyTuple_CheckExact(value))
        || PySequence_Fast_GET_SIZE(value) != PyArray_DIM(like, axis)) {
        return 0;
    }
    for (Py_ssize_t i = 0; i < PyArray_DIM(like, axis); i++) {
        if (!copy_numbers(PySequence_Fast_GET_ITEM(value, i), like, axis + 1, place)) {
            return 0;
        }
    }
    return 1;
}

/* Copies a result that is finite numbers, in the order and the type in which they are needed or in
 * a list; returns 0 if it is another one. */
static int copy_plain(PyObject *value, PyObject *context, double *f)
{
    PyArrayObject *like = (PyArrayObject *)PyTuple_GET_ITEM(context, LIKE_RESULT);
    double *place = f;
    if (PyArray_CheckExact(value)) {
        if (!is_like((PyArrayObject *)value, like)) {
            return 0;
        }
        memcpy(f, PyArray_DATA((PyArrayObject *)value), (size_t)PyArray_NBYTES(like));
    } else if (PyArray_TYPE(like) != NPY_DOUBLE || !copy_numbers(value, like, 0, &place)) {
        return 0;
    }
    const Py_ssize_t count = PyArray_NBYTES(like) / (Py_ssize_t)sizeof(double);
    double sum = 0.0;
    for (Py_ssize_t i = 0; i < count; i++) {
        sum += f[i];
    }
    return isfinite(sum);
}

int call_python_rhs(double t, const double *y, double *f, void *user_data)
{
    PyObject *context = *(PyObject **)user_data;
    int code = RAISED_IN_PYTHON;
    PyGILState_STATE lock = PyGILState_Ensure();
    PyObject *time = NULL, *point = NULL, *value = NULL;
    if (!PyErr_Occurred()) { /* otherwise another function has raised it */
        time = PyFloat_FromDouble(t);
        point = make_array(context, POINT, PyTuple_GET_ITEM(context, LIKE_POINT), y);
    }
    if (time != NULL && point != NULL) {
        value = call(context, time, point);
    }
    if (value != NULL && copy_plain(value, context, f)) {
        code = 0;
    } else if (value != NULL) {
        PyObject *checked = PyObject_CallFunctionObjArgs(PyTuple_GET_ITEM(context, CHECK), value,
                                                         time, point, NULL);
        if (checked != NULL) {
            memcpy(f, PyArray_DATA((PyArrayObject *)checked),
                   (size_t)PyArray_NBYTES((PyArrayObject *)checked));
            Py_DECREF(checked);
            code = 0;
        }
    }
    if (point != NULL) {
        keep_spare(context, POINT, point);
    }
    Py_XDECREF(value);
    Py_XDECREF(point);
    Py_XDECREF(time);
    PyGILState_Release(lock);
    return code;
}

static PyObject *vector(int count, const double *x)
{
    npy_intp length = count;
    PyObject *array = PyArray_SimpleNew(1, &length, NPY_DOUBLE);
    if (array != NULL) {
        memcpy(PyArray_DATA((PyArrayObject *)array), x, (size_t)count * sizeof(double));
    }
    return array;
}

/* Calls a function of Python as context(operation, a, b), which returns an array of nc numbers.
 * Returns 0, or another number if it raised an exception, which is then set. */
int call_python(void *context, int operation, int na, const double *a, int nb, const double *b,
                int nc, double *c)
{
    int code = RAISED_IN_PYTHON;
    PyGILState_STATE lock = PyGILState_Ensure();
    PyObject *value = NULL, *array = NULL;
    if (!PyErr_Occurred()) { /* N takes references, and passes on that memory is exhausted */
        value = PyObject_CallFunction(context, "iNN", operation, vector(na, a), vector(nb, b));
    }
    if (value != NULL) {
        array = PyArray_FROM_OTF(value, NPY_DOUBLE, NPY_ARRAY_CARRAY);
    }
    if (array != NULL && PyArray_SIZE((PyArrayObject *)array) == nc) {
        memcpy(c, PyArray_DATA((PyArrayObject *)array), (size_t)nc * sizeof(double));
        code = 0;
    } else if (array != NULL) {
        PyErr_Format(PyExc_ValueError, "operation %d must return %d numbers", operation, nc);
    }
    Py_XDECREF(array);
    Py_XDECREF(value);
    PyGILState_Release(lock);
    return code;
}
