//! The macros behind the message table: one declaration gives the type, its place in the schema
//! hash, and its entry in docs/protocol.md.

/// A field of a message, or a variant of an enumeration, as documentation sees it.
#[derive(Clone, Copy, Debug)]
pub struct Item {
    /// Field or variant name.
    pub name: &'static str,
    /// Rust type of a field; number of a variant.
    pub kind: &'static str,
    /// Its documentation.
    pub doc: &'static str,
}

/// Part that a message plays in a conversation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Sent by both ends.
    Both,
    /// Asks the device for its answer.
    Request,
    /// Tells the device something that is not answered.
    Notice,
    /// Answers a request.
    Answer,
    /// Sent by the device of its own accord.
    Event,
}

impl Part {
    /// `true` if the message carries a request's number.
    pub const fn is_numbered(self) -> bool {
        matches!(self, Self::Request | Self::Answer)
    }

    /// Part in words.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Both => "both ends",
            Self::Request => "request to the device",
            Self::Notice => "notice to the device",
            Self::Answer => "answer of the device",
            Self::Event => "event from the device",
        }
    }
}

/// A message or an enumeration, as documentation sees it.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Message id; `None` for an enumeration.
    pub id: Option<u8>,
    /// Part that the message plays; `None` for an enumeration.
    pub part: Option<Part>,
    /// Answer that a request gets where it is carried out.
    pub answer: Option<&'static str>,
    /// `true` if the request is sent once only.
    pub is_sent_once: bool,
    /// Type name.
    pub name: &'static str,
    /// Its documentation.
    pub doc: &'static str,
    /// Fields in wire order, or variants in order of their number.
    pub items: &'static [Item],
}

/// FNV-1a over `text`, continuing from `hash`, white space skipped because `stringify!` may
/// space tokens differently from one compiler to the next.
pub const fn fnv1a(hash: u64, text: &str) -> u64 {
    let bytes = text.as_bytes();
    let mut h = hash;
    let mut k = 0;
    while k < bytes.len() {
        if !bytes[k].is_ascii_whitespace() {
            h ^= bytes[k] as u64;
            h = h.wrapping_mul(0x0000_0100_0000_01b3);
        }
        k += 1;
    }
    h
}

/// Folds an entry's shape (names, types, order; not its documentation) into a hash.
pub const fn fold_entry(hash: u64, entry: &Entry) -> u64 {
    let mut h = fnv1a(hash, entry.name);
    if let Some(id) = entry.id {
        h = (h ^ id as u64).wrapping_mul(0x0000_0100_0000_01b3);
    }
    if let Some(part) = entry.part {
        h = fnv1a(h, part.text());
    }
    if let Some(answer) = entry.answer {
        h = fnv1a(h, answer);
    }
    let mut k = 0;
    while k < entry.items.len() {
        h = fnv1a(h, entry.items[k].name);
        h = fnv1a(h, ":");
        h = fnv1a(h, entry.items[k].kind);
        h = fnv1a(h, ";");
        k += 1;
    }
    h
}

/// Offset basis of FNV-1a, 64 bit.
pub const FNV_BASIS: u64 = 0xcbf2_9ce4_8422_2325;

/// Declares an enumeration that travels by its number. Numbers count from 0 without a gap, so
/// that postcard's variant index is the number.
macro_rules! wire_enum {
    ($(#[doc = $doc:literal])+ pub enum $name:ident {
        $($(#[doc = $vdoc:literal])+ $variant:ident = $number:literal,)+
    }) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        #[repr(u8)]
        pub enum $name {
            $($(#[doc = $vdoc])+ $variant = $number,)+
        }
        impl Default for $name {
            fn default() -> Self {
                Self::ALL[0]
            }
        }
        impl $name {
            /// Name in documentation, files and API.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => stringify!($variant),)+
                }
            }
            /// Every variant, in order of its number.
            pub const ALL: &'static [$name] = &[$($name::$variant),+];
            /// The entry in the protocol's documentation and schema hash.
            pub const ENTRY: $crate::wire::schema::Entry = $crate::wire::schema::Entry {
                id: None,
                part: None,
                answer: None,
                is_sent_once: false,
                name: stringify!($name),
                doc: concat!($($doc),+),
                items: &[$($crate::wire::schema::Item {
                    name: stringify!($variant),
                    kind: stringify!($number),
                    doc: concat!($($vdoc),+),
                }),+],
            };
        }
    };
}
pub(crate) use wire_enum;
