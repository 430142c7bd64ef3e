//! One row of the message table as a type: traits, decoding, and the macros that make them.

use serde::{Deserialize, Serialize};

use super::schema::Part;

/// A message with its number in the table.
pub trait Message: Serialize {
    /// Number of the message; never reused.
    const ID: u8;
    /// Name in the table.
    const NAME: &'static str;
    /// Part that it plays.
    const PART: Part;
}

/// A request, bound to its answer.
pub trait Request: Message {
    /// Answer where the request is carried out; [`super::messages::Reply`] where it is not.
    type Answer<'a>: Message + Deserialize<'a>;
    /// `true` if it is sent once only. Any other is sent again, under its number, while its answer stays away: a device
    /// carries it out once.
    const IS_SENT_ONCE: bool;
}

/// Decodes a message from its bytes behind the number; they must be used up.
///
/// # Errors
/// [`DecodeError::Malformed`], [`DecodeError::Trailing`].
pub fn decode<'a, M: Message + Deserialize<'a>>(bytes: &'a [u8]) -> Result<M, DecodeError> {
    let id = M::ID;
    match postcard::take_from_bytes(bytes) {
        Ok((message, [])) => Ok(message),
        Ok((_, rest)) => Err(DecodeError::Trailing {
            id,
            bytes: rest.len(),
        }),
        Err(_) => Err(DecodeError::Malformed { id }),
    }
}

/// Reason that a payload is not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// No message has this id.
    UnknownId {
        /// The id.
        id: u8,
    },
    /// The payload does not decode as the message of this id.
    Malformed {
        /// The id.
        id: u8,
    },
    /// The message decoded, but bytes were left over.
    Trailing {
        /// The id.
        id: u8,
        /// Number of bytes left.
        bytes: usize,
    },
}

impl core::fmt::Display for DecodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::UnknownId { id } => write!(f, "no message has id {id:#04x}"),
            Self::Malformed { id } => write!(f, "payload does not decode as message {id:#04x}"),
            Self::Trailing { id, bytes } => {
                write!(f, "{bytes} bytes left over after message {id:#04x}")
            }
        }
    }
}

impl core::error::Error for DecodeError {}

/// Implements [`Request`] for a row with an answer.
macro_rules! bind_answer {
    ([$($request:tt)+] [$($generics:tt)*]) => {};
    ([$($request:tt)+] [$($generics:tt)*] $answer:ident $($once:ident)?) => {
        impl $($generics)* Request for $($request)+ {
            type Answer<'answer> = $answer;
            const IS_SENT_ONCE: bool = bind_answer!(@once $($once)?);
        }
    };
    ([$($request:tt)+] [$($generics:tt)*] $answer:ident<$lt:lifetime> $($once:ident)?) => {
        impl $($generics)* Request for $($request)+ {
            type Answer<'answer> = $answer<'answer>;
            const IS_SENT_ONCE: bool = bind_answer!(@once $($once)?);
        }
    };
    (@once once) => { true };
    (@once) => { false };
}

macro_rules! message_table {
    ($lt:lifetime; $(
        $(#[doc = $doc:literal])+
        $id:literal $part:ident $name:ident $(<$l:lifetime>)?
        $(-> $answer:ident $(<$al:lifetime>)? $($once:ident)?)? {
            $($(#[doc = $fdoc:literal])+ $(#[serde($attr:ident)])? $field:ident : $ty:ty,)*
        }
    )+) => {
        $(
            $(#[doc = $doc])+
            #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
            pub struct $name $(<$l>)? {
                $($(#[doc = $fdoc])+ $(#[serde($attr)])? pub $field: $ty,)*
            }
            impl $(<$l>)? Message for $name $(<$l>)? {
                const ID: u8 = $id;
                const NAME: &'static str = stringify!($name);
                const PART: Part = Part::$part;
            }
            bind_answer!([$name $(<$l>)?] [$(<$l>)?] $($answer $(<$al>)? $($once)?)?);
        )+

        /// Any message of the table, borrowed from the bytes it was decoded from.
        #[derive(Clone, Debug, PartialEq)]
        pub enum AnyMessage<$lt> {
            $(
                #[doc = concat!("See [`", stringify!($name), "`].")]
                $name($name $(<$l>)?),
            )+
        }

        impl<$lt> AnyMessage<$lt> {
            /// Decodes the bytes of message `id` behind its number; they must be used up.
            pub fn decode(id: u8, bytes: &$lt [u8]) -> Result<Self, DecodeError> {
                match id {
                    $($id => decode::<$name>(bytes).map(Self::$name),)+
                    _ => Err(DecodeError::UnknownId { id }),
                }
            }

            /// The message's id, and its bytes behind the number written to the front of `out`; `None` where that
            /// is too small.
            pub fn bytes<'o>(&self, out: &'o mut [u8]) -> Option<(u8, &'o [u8])> {
                match self {
                    $(Self::$name(m) => Some(($id, &*postcard::to_slice(m, out).ok()?)),)+
                }
            }
        }

        /// Part that message `id` plays; `None` for one that is not in the table.
        pub const fn part_of(id: u8) -> Option<Part> {
            match id {
                $($id => Some(Part::$part),)+
                _ => None,
            }
        }

        /// Every message, in table order.
        pub const MESSAGES: &[Entry] = &[$(Entry {
            id: Some($id),
            part: Some(Part::$part),
            answer: message_table!(@answer $($answer)?),
            is_sent_once: message_table!(@once $($($once)?)?),
            name: stringify!($name),
            doc: concat!($($doc),+),
            items: &[$(Item {
                name: stringify!($field),
                kind: stringify!($ty),
                doc: concat!($($fdoc),+),
            }),*],
        }),+];
    };
    (@answer) => { None };
    (@answer $answer:ident) => { Some(stringify!($answer)) };
    (@once) => { false };
    (@once once) => { true };
}

pub(super) use {bind_answer, message_table};
